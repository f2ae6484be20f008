"""The instants of each robot the graph has a pose for, and the odometry between them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.odometry_correction import NOT_CORRECTED, OdometryCorrection, noise_stretch
from mulan.mission.types import RobotLog
from mulan.wireless.odometry_drift import covariance_at, relative_covariance
from mulan.wireless.types import Bearing, Range


@dataclass(frozen=True)
class OdometryNoise:
    """Drift assumed where the odometry reports none."""

    rotation_deg_per_sqrt_m: float = 0.2
    """Yaw random walk, degrees after one metre."""
    translation_percent: float = 1.0
    """Position random walk: 1 % is 0.01 m, each axis, after one metre."""
    tilt_deg: float = 0.2
    """Roll and pitch error; gravity keeps it from growing."""
    rotation_floor_rad: float = 1e-4
    """Added to every step, so that a standstill is not infinitely certain."""
    translation_floor_m: float = 2e-4
    """Added to every step."""


@dataclass(frozen=True)
class Keyframes:
    """One robot's poses in the graph.

    Attributes:
        robot: Name.
        time_s: Instants, increasing; the first is the start of the odometry.
        T_odom_body: Dead reckoning there, scaled by the correction.
        step_covariance: Of the motion from each keyframe to the next (right perturbation of the latter).
        tilt_variance_rad2: Of roll and pitch at each keyframe against gravity.
        correction: Already in the poses and covariances.
    """

    robot: str
    time_s: Float[NDArray, "n"]
    T_odom_body: Float[NDArray, "n 4 4"]
    step_covariance: Float[NDArray, "m 6 6"]
    tilt_variance_rad2: Float[NDArray, "n"]
    correction: OdometryCorrection = NOT_CORRECTED

    def nearest(self, time_s: float) -> int:
        """Index of the keyframe nearest in time."""
        return int(np.abs(self.time_s - time_s).argmin())

    def point_in_keyframe(self, index: int, point_odom_m: Float[NDArray, "3"]) -> Float[NDArray, "3"]:
        """A point given in the odometry frame, carried rigidly by a keyframe's body.

        The scale is left out: from a keyframe to a measurement that hangs on it the body hardly moves.
        """
        T = self.T_odom_body[index].copy()
        T[:3, 3] = (
            self.T_odom_body[0, :3, 3] + (T[:3, 3] - self.T_odom_body[0, :3, 3]) / self.correction.scale
        )
        return se3.transform(se3.inverse(T), point_odom_m)


def _photographs_kept(
    robot: RobotLog, photo_s: Float[NDArray, "p"], every_m: float, every_s: float
) -> Float[NDArray, "k"]:
    """Photographs far enough, in metres or seconds, from the last one kept; always the last."""
    if len(photo_s) == 0 or min(every_m, every_s) <= 0:
        return photo_s
    at_m = np.interp(photo_s, robot.odometry.time_s, _travelled_m(robot))
    kept = [0]
    for i in range(1, len(photo_s)):
        if at_m[i] - at_m[kept[-1]] >= every_m or photo_s[i] - photo_s[kept[-1]] >= every_s:
            kept.append(i)
    return photo_s[np.unique([*kept, len(photo_s) - 1])]


def keyframe_times(
    robot: RobotLog,
    measured_s: Float[NDArray, "m"],
    merge_s: float,
    photo_every_m: float = 0.0,
    photo_every_s: float = 0.0,
) -> Float[NDArray, "n"]:
    """Start, photographs, and measurement instants farther than ``merge_s`` from any earlier chosen one.

    Photographs nearer than both ``photo_every_m`` and ``photo_every_s`` to the last chosen are left out;
    where either is zero, none is.

    Raises:
        InputError: A photograph lies outside the odometry.
    """
    begin, end = float(robot.odometry.time_s[0]), float(robot.odometry.time_s[-1])
    photos = robot.photo_time_s
    late = photos[(photos < begin - merge_s) | (photos > end + merge_s)]
    if len(late):
        raise InputError(
            f"/{robot.name}/odometry",
            "time",
            f"covers {begin:.2f} to {end:.2f} s but a photograph was taken at {late[0]:.2f} s",
            "record odometry during the whole mission, or check the robot's clock",
        )
    kept = _photographs_kept(robot, photos, photo_every_m, photo_every_s)
    chosen = np.unique(np.concatenate([[begin], np.clip(kept, begin, end)]))
    extra = []
    for t in np.sort(measured_s[(measured_s >= begin) & (measured_s <= end)]):
        k = np.searchsorted(chosen, t)
        near = chosen[max(k - 1, 0) : k + 1]
        if np.abs(near - t).min() > merge_s and (not extra or t - extra[-1] > merge_s):
            extra.append(float(t))
    return np.unique(np.concatenate([chosen, extra]))


def _without_tilt(T: Float[NDArray, "n 4 4"], covariance: Float[NDArray, "n 6 6"]) -> Float[NDArray, "n 6 6"]:
    """Keep only rotation about the vertical: bounded tilt is no random walk and cannot be differenced."""
    R = T[:, :3, :3]
    keep = np.zeros((len(T), 6, 6))
    keep[:, :3, :3] = np.swapaxes(R, 1, 2)[:, :, 2:] @ R[:, 2:, :]
    keep[:, 3:, 3:] = np.eye(3)
    return keep @ covariance @ np.swapaxes(keep, 1, 2)


def _travelled_m(robot: RobotLog) -> Float[NDArray, "n"]:
    """Path length at each odometry sample."""
    steps = np.linalg.norm(np.diff(robot.odometry.T_odom_body[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def step_noise(
    T_odom_body: Float[NDArray, "n 4 4"],
    accumulated: Float[NDArray, "n 6 6"] | None,
    step_m: Float[NDArray, "m"],
    noise: OdometryNoise,
    gravity_aligned: bool,
    floor_fraction: Float[NDArray, "m"] | None = None,
) -> tuple[Float[NDArray, "m 6 6"], Float[NDArray, "n"]]:
    """Covariance of every step (right perturbation of the later pose), and of roll and pitch at every pose.

    Args:
        T_odom_body: Dead reckoning.
        accumulated: Covariance since the start at each pose, or None where the driver gives none.
        step_m: Path length of every step.
        noise: Drift assumed where none is given, and floors.
        gravity_aligned: Roll and pitch are bounded errors, no random walk.
        floor_fraction: Part of what every step gets whatever its length (tilt and the floors) that each step
            gets here; all of it by default. For steps cut into pieces.
    """
    tilt_variance = np.full(len(T_odom_body), np.deg2rad(noise.tilt_deg) ** 2)
    if accumulated is None:
        step = np.zeros((len(step_m), 6, 6))
        rotation = np.deg2rad(noise.rotation_deg_per_sqrt_m) ** 2
        step[:, [0, 1, 2], [0, 1, 2]] = rotation * step_m[:, None]
        step[:, [3, 4, 5], [3, 4, 5]] = (noise.translation_percent / 100) ** 2 * step_m[:, None]
    else:
        if gravity_aligned:
            R = T_odom_body[:, :3, :3]
            in_odom_axes = R @ accumulated[:, :3, :3] @ np.swapaxes(R, 1, 2)
            tilt_variance = (in_odom_axes[:, 0, 0] + in_odom_axes[:, 1, 1]) / 2
            accumulated = _without_tilt(T_odom_body, accumulated)
        step = relative_covariance(T_odom_body[:-1], accumulated[:-1], T_odom_body[1:], accumulated[1:])
    fixed = np.zeros_like(step)
    if gravity_aligned:
        R = T_odom_body[1:, :3, :3]
        # tilt errors of two keyframes may differ by twice the variance; gravity factors hold each of them
        level = np.swapaxes(R, 1, 2) @ np.diag([1.0, 1.0, 0.0]) @ R
        fixed[:, :3, :3] += 2 * tilt_variance[1:, None, None] * level
    fixed[:, [0, 1, 2], [0, 1, 2]] += noise.rotation_floor_rad**2
    fixed[:, [3, 4, 5], [3, 4, 5]] += noise.translation_floor_m**2
    if floor_fraction is not None:
        fixed *= floor_fraction[:, None, None]
    return step + fixed, tilt_variance


def make_keyframes(
    robot: RobotLog,
    time_s: Float[NDArray, "n"],
    noise: OdometryNoise,
    gravity_aligned: bool,
    floor_fraction: Float[NDArray, "m"] | None = None,
    correction: OdometryCorrection = NOT_CORRECTED,
) -> Keyframes:
    """Dead reckoning at the keyframes and how much it drifts between them.

    Args:
        robot: Its odometry and whether that reports a covariance.
        time_s: Keyframes.
        noise: Drift where it reports none.
        gravity_aligned: Roll and pitch are bounded errors, no random walk.
        floor_fraction: As in ``step_noise``.
        correction: Learned scale and noise.
    """
    T = se3.interpolate(robot.odometry.time_s, robot.odometry.T_odom_body, time_s)
    step_m = np.diff(np.interp(time_s, robot.odometry.time_s, _travelled_m(robot)))
    step, tilt_variance = step_noise(
        T, covariance_at(robot.odometry, time_s), step_m, noise, gravity_aligned, floor_fraction
    )
    plain = Keyframes(robot.name, time_s, T, step, tilt_variance)
    return corrected_keyframes(plain, correction, gravity_aligned)


def corrected_keyframes(
    keyframes: Keyframes, correction: OdometryCorrection, gravity_aligned: bool
) -> Keyframes:
    """Uncorrected keyframes with a learned scale and noise."""
    T = keyframes.T_odom_body.copy()
    T[:, :3, 3] = T[0, :3, 3] + correction.scale * (T[:, :3, 3] - T[0, :3, 3])
    stretch = noise_stretch(T[1:], correction, gravity_aligned)
    return replace(
        keyframes,
        T_odom_body=T,
        step_covariance=stretch @ keyframes.step_covariance @ stretch,
        correction=correction,
    )


def clock_offset_s(observer: str, peer: str, bearings: Sequence[Bearing]) -> float:
    """What to add to the observer's clock to get the peer's, from packets both stamped; zero without any."""
    offsets = [b.peer_time_s - b.time_s for b in bearings if (b.observer, b.peer) == (observer, peer)]
    offsets += [b.time_s - b.peer_time_s for b in bearings if (b.peer, b.observer) == (observer, peer)]
    return float(np.median(offsets)) if offsets else 0.0


def measurement_times(
    robot: str, bearings: Sequence[Bearing], ranges: Sequence[Range]
) -> Float[NDArray, "m"]:
    """Instants on a robot's own clock at which it took part in a bearing or a range."""
    times = [b.time_s for b in bearings if b.observer == robot]
    times += [b.peer_time_s for b in bearings if b.peer == robot]
    times += [r.time_s for r in ranges if r.observer == robot]
    offset = {b: clock_offset_s(b, robot, bearings) for b in {r.observer for r in ranges if r.peer == robot}}
    times += [r.time_s + offset[r.observer] for r in ranges if r.peer == robot]
    return np.array(times, dtype=float)
