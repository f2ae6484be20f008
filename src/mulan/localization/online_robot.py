"""One robot's keyframes as they arrive, and where a measurement hangs on them."""

from bisect import bisect_left
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.keyframes import step_noise
from mulan.mission.types import OdometryTrack, Photo, RobotLog


@dataclass
class OnlineRobot:
    """A growing chain of keyframes.

    Attributes:
        log: Name and calibration; what it recorded is not read.
        first_key: Key of the first keyframe; the others follow.
        time_s, T_odom_body, covariance: One entry a keyframe; covariance as in OdometryTrack.
        step_covariance: Of the motion into each keyframe from the one before (zeros for the first).
        tilt_variance_rad2: One entry a keyframe.
        received: After how many updates each keyframe came.
        T_world_body: Poses of the keyframes the solver has or had, from ``first_solved`` on.
        first_solved: First keyframe the solver was given.
        in_graph: How many keyframes, from the first of all on, came before the next the solver will get.
        oldest: First keyframe still in the solver's window.
        waiting_from: First keyframe of the stretch whose place is unknown; None while placed.
    """

    log: RobotLog
    first_key: int
    time_s: list[float] = field(default_factory=list)
    T_odom_body: list[Float[NDArray, "4 4"]] = field(default_factory=list)
    covariance: list[Float[NDArray, "6 6"] | None] = field(default_factory=list)
    step_covariance: list[Float[NDArray, "6 6"]] = field(default_factory=list)
    tilt_variance_rad2: list[float] = field(default_factory=list)
    received: list[int] = field(default_factory=list)
    T_world_body: list[Float[NDArray, "4 4"]] = field(default_factory=list)
    first_solved: int = 0
    in_graph: int = 0
    oldest: int = 0
    waiting_from: int | None = 0

    @property
    def name(self) -> str:
        """Of the robot."""
        return self.log.name

    @property
    def placed(self) -> bool:
        """Whether the solver has its keyframes."""
        return self.waiting_from is None

    def key(self, index: int) -> int:
        """Key of a keyframe."""
        return self.first_key + index

    def add(
        self,
        time_s: float,
        T_odom_body: Float[NDArray, "4 4"],
        covariance: Float[NDArray, "6 6"] | None,
        config: LocalizationConfig,
        received: int,
    ) -> None:
        """Append a keyframe, received after so many updates.

        Raises:
            InputError: It is not later than the last one, or not finite.
        """
        if not (np.isfinite(time_s) and np.isfinite(T_odom_body).all()):
            raise InputError(f"robot '{self.name}'", "keyframe", "is not finite", "drop it")
        if self.time_s and time_s <= self.time_s[-1]:
            problem = f"{time_s:.3f} s is not after the last one at {self.time_s[-1]:.3f} s"
            raise InputError(f"robot '{self.name}'", "keyframe", problem, "send keyframes in order of time")
        poses, known = [*self.T_odom_body[-1:], T_odom_body], [*self.covariance[-1:], covariance]
        given = [c for c in known if c is not None]
        away_m = np.linalg.norm(np.diff([T[:3, 3] for T in poses], axis=0), axis=1)
        steps, tilt = step_noise(
            np.array(poses),
            np.array(given) if len(given) == len(known) else None,
            away_m,
            config.odometry_noise,
            config.gravity_aligned,
        )
        self.step_covariance.append(steps[0] if len(steps) else np.zeros((6, 6)))
        self.tilt_variance_rad2.append(float(tilt[-1]))
        self.received.append(received)
        self.time_s.append(float(time_s))
        self.T_odom_body.append(T_odom_body)
        self.covariance.append(covariance)

    def step(self, index: int) -> Float[NDArray, "4 4"]:
        """Motion into a keyframe from the one before."""
        return se3.inverse(self.T_odom_body[index - 1]) @ self.T_odom_body[index]

    def nearest(self, time_s: float, merge_s: float, longest_gap_s: float) -> int | None:
        """Keyframe a measurement hangs on.

        None: its instant is beyond the newest keyframe; -1: it fell into a gap and can hang nowhere.
        """
        newest = len(self.time_s) - 1
        if newest < 0 or time_s > self.time_s[newest] + merge_s:
            return None
        at = bisect_left(self.time_s, time_s)
        near = [i for i in (at - 1, at) if 0 <= i <= newest]
        best = min(near, key=lambda i: abs(self.time_s[i] - time_s))
        if abs(self.time_s[best] - time_s) <= merge_s:
            return best
        bracketed = len(near) == 2 and self.time_s[near[1]] - self.time_s[near[0]] <= longest_gap_s
        return best if bracketed else -1

    def pose_odom(self, time_s: float) -> Float[NDArray, "4 4"]:
        """Odometry at an instant, between the keyframes around it."""
        at = bisect_left(self.time_s, time_s)
        if at < len(self.time_s) and self.time_s[at] == time_s:
            return self.T_odom_body[at]
        low = max(at - 1, 0)
        times, poses = self.time_s[low : low + 2], self.T_odom_body[low : low + 2]
        return se3.interpolate(np.array(times), np.array(poses), np.array([time_s]))[0]

    def point_in_keyframe(self, index: int, point_odom_m: Float[NDArray, "3"]) -> Float[NDArray, "3"]:
        """A point of the odometry frame, carried rigidly by a keyframe's body."""
        return se3.transform(se3.inverse(self.T_odom_body[index]), point_odom_m)

    def recorded(self, first: int, end: int) -> RobotLog:
        """The log of some keyframes: each an odometry sample and a photograph whose pixels are left out."""
        known = self.covariance[first:end]
        given = None if any(c is None for c in known) else np.array(known).reshape(-1, 6, 6)
        times, poses = np.array(self.time_s[first:end]), np.array(self.T_odom_body[first:end])
        photos = tuple(Photo(t, "png", b"") for t in self.time_s[first:end])
        track = OdometryTrack(times, poses.reshape(-1, 4, 4), given)
        return replace(self.log, odometry=track, photos=photos)

    def drift(self, index: int, later: int) -> tuple[Float[NDArray, "6 6"], Float[NDArray, "6 6"]]:
        """How an error of one keyframe is carried to a later one (adjoint), and what is added on the way."""
        carry, added = np.eye(6), np.zeros((6, 6))
        for i in range(index + 1, later + 1):
            adjoint = gtsam.Pose3(self.step(i)).inverse().AdjointMap()
            carry, added = adjoint @ carry, adjoint @ added @ adjoint.T + self.step_covariance[i]
        return carry, added

    def motion_factors(
        self, index: int, config: LocalizationConfig, floor_m: float
    ) -> list[gtsam.NonlinearFactor]:
        """Odometry into a keyframe, its gravity and its floor, as the batch graph has them."""
        factors: list[gtsam.NonlinearFactor] = []
        key = self.key(index)
        if index > self.first_solved:
            noise = gtsam.noiseModel.Gaussian.Covariance(self.step_covariance[index])
            factors.append(gtsam.BetweenFactorPose3(key - 1, key, gtsam.Pose3(self.step(index)), noise))
        if config.gravity_aligned:
            up = np.array([0.0, 0.0, 1.0])
            variance = self.tilt_variance_rad2[index] + np.deg2rad(config.gravity_sigma_deg) ** 2
            noise = gtsam.noiseModel.Isotropic.Variance(2, float(variance))
            seen_up = gtsam.Unit3(self.T_odom_body[index][:3, :3].T @ up)
            factors.append(gtsam.AttitudeFactorPose3(key, gtsam.Unit3(up), noise, seen_up))
        if config.common_floor_sigma_m is not None:
            sigmas = np.array([1e3, 1e3, max(config.common_floor_sigma_m, 1e-4)])
            noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
            factors.append(gtsam.PoseTranslationPrior3D(key, np.array([0.0, 0.0, floor_m]), noise))
        return factors
