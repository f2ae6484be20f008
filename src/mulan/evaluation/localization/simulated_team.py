"""Robots that wander, dead-reckon and measure each other, drawn straight from the truth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from mulan.evaluation.localization.drawn_bearing import drawn_bearing
from mulan.geometry import se3, so3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import OdometryTrack, Photo, PoseTrack, RobotLog
from mulan.wireless.types import Bearing, Range

WIFI_BODY_M = np.array([0.10, 0.00, 0.05])
UWB_BODY_M = np.array([0.00, 0.10, 0.02])
CAMERA_BODY_M = np.array([0.05, 0.00, 0.10])
_DETOUR_M = 2.0  # mean excess of a wrong range
_NEIGHBOUR_M = 4.0  # side of the square each robot of a fleet has to itself


@dataclass(frozen=True)
class Case:
    """One kind of team to simulate.

    Attributes:
        name: Key of the results.
        trials: Teams drawn.
        robots: Number of robots.
        meetings: Places at which each pair in reach measures: a bearing from either side and one range.
        outlier_share: Share of bearings that point anywhere and of ranges that took a detour.
        drifting: Odometry drifts; otherwise it is exact.
        samples: Odometry samples of each robot.
    """

    name: str
    trials: int
    robots: int = 2
    meetings: int = 5
    outlier_share: float = 0.0
    drifting: bool = False
    samples: int = 101


@dataclass(frozen=True)
class Noise:
    """What is added to the truth, one sigma each; the estimator is told the same."""

    bearing_deg: float = 5.0
    """Bearings, along each tangent."""
    range_m: float = 0.05
    """Ranges."""
    drift_percent: float = 1.0
    """Position random walk of drifting odometry: 1 % is 0.01 m, each axis, after one metre."""
    drift_deg_per_sqrt_m: float = 0.5
    """Yaw random walk of drifting odometry."""
    radio_reach_m: float = 8.0
    """Robots of a fleet farther apart than this at the start do not hear each other."""


@dataclass(frozen=True)
class SimulatedTeam:
    """What was drawn.

    Attributes:
        robots: Logs with ground truth; the first is the anchor.
        bearings, ranges: Measurements as the radios would report them.
        bearing_at: Robot index of the observer and of the peer, and sample index, of each bearing.
        range_at: The same of each range.
        bearing_right, range_right: False where the measurement is an outlier.
        photo_at: Sample indices of the photographs, equal for all robots.
    """

    robots: tuple[RobotLog, ...]
    bearings: tuple[Bearing, ...]
    ranges: tuple[Range, ...]
    bearing_at: Int[NDArray, "b 3"]
    range_at: Int[NDArray, "r 3"]
    bearing_right: Bool[NDArray, "b"]
    range_right: Bool[NDArray, "r"]
    photo_at: Int[NDArray, "p"]

    @property
    def T_truth_body(self) -> Float[NDArray, "robots samples 4 4"]:
        """True body poses."""
        return np.array([r.ground_truth.T_world_body for r in self.robots if r.ground_truth is not None])


def _wander(rng: np.random.Generator, centre_m: Float[NDArray, "3"], samples: int) -> Float[NDArray, "n 4 4"]:
    """A smooth path about a point, some 15 m long, the level body slowly turning."""
    s = np.linspace(0, 1, samples)[:, None]
    turns, phase = rng.uniform(0.8, 2.0, 3), rng.uniform(0, 2 * np.pi, 3)
    path = centre_m + np.array([1.5, 1.5, 0.5]) * np.sin(2 * np.pi * turns * s + phase)
    heading = rng.uniform(-np.pi, np.pi) + rng.uniform(-4, 4) * s[:, 0]
    return se3.from_parts(so3.about_z(heading), path)


def step_sigma(length_m: Float[NDArray, "m"], noise: Noise) -> Float[NDArray, "m 2"]:
    """Sigma of yaw [rad] and of each axis of translation [m] over steps of these lengths."""
    rate = np.array([np.deg2rad(noise.drift_deg_per_sqrt_m), noise.drift_percent / 100])
    return np.sqrt(length_m)[:, None] * rate


def _dead_reckoning(
    rng: np.random.Generator, T: Float[NDArray, "n 4 4"], noise: Noise | None
) -> tuple[Float[NDArray, "n 4 4"], Float[NDArray, "n 6 6"]]:
    """Odometry from the robot's own start and its accumulated covariance; exact without noise."""
    steps = se3.inverse(T[:-1]) @ T[1:]
    sigma = np.zeros((len(steps), 6))
    if noise is not None:
        by_step = step_sigma(np.linalg.norm(steps[:, :3, 3], axis=1), noise)
        sigma[:, 2], sigma[:, 3:] = by_step[:, 0], by_step[:, 1:]
    noisy = steps @ se3.exp(sigma * rng.normal(size=sigma.shape))
    odometry, covariance = [np.eye(4)], [np.zeros((6, 6))]
    for step, spread in zip(noisy, sigma, strict=True):
        odometry.append(odometry[-1] @ step)
        covariance.append(se3.covariance_of_composition(step, covariance[-1]) + np.diag(spread**2))
    return np.array(odometry), np.array(covariance)


def _robot(
    rng: np.random.Generator,
    name: str,
    centre_m: Float[NDArray, "3"],
    samples: int,
    photo_at: Int[NDArray, "p"],
    noise: Noise | None,
) -> RobotLog:
    T = _wander(rng, centre_m, samples)
    time_s = np.arange(samples, dtype=float)
    T_odom, covariance = _dead_reckoning(rng, T, noise)
    return RobotLog(
        name=name,
        camera=PinholeCamera(40, 30, 30.0, 30.0, 20.0, 15.0),
        T_body_camera=se3.from_parts(np.eye(3), CAMERA_BODY_M),
        wifi_antenna_body_m=WIFI_BODY_M,
        uwb_antenna_body_m=UWB_BODY_M,
        photos=tuple(Photo(float(t), "png", b"") for t in time_s[photo_at]),
        odometry=OdometryTrack(time_s, T_odom, covariance),
        csi={},
        ranges={},
        ground_truth=PoseTrack(time_s, T),
    )


def told_share(share: float) -> float:
    """The outlier mass the estimator is told: calibrated, but never nought."""
    return max(share, 0.02)


def _range(
    rng: np.random.Generator, observer: RobotLog, peer: RobotLog, i: int, noise: Noise, share: float
) -> tuple[Range, bool]:
    assert observer.ground_truth is not None
    assert peer.ground_truth is not None
    To, Tp = observer.ground_truth.T_world_body[i], peer.ground_truth.T_world_body[i]
    apart = np.linalg.norm(se3.transform(Tp, UWB_BODY_M) - se3.transform(To, UWB_BODY_M))
    wrong = bool(rng.random() < share)
    detour = rng.exponential(_DETOUR_M) if wrong else 0.0
    range_m = max(float(apart + detour + noise.range_m * rng.normal()), 0.05)
    told = Range(observer.name, peer.name, float(i), range_m, noise.range_m, told_share(share))
    return told, not wrong


def _centres(rng: np.random.Generator, robots: int, reach_m: float) -> Float[NDArray, "n 3"]:
    """Two robots 2.5 to 5 m apart; a fleet spread over a square, all tied together by radio."""
    if robots == 2:
        angle, apart = rng.uniform(-np.pi, np.pi), rng.uniform(2.5, 5.0)
        away = np.array([apart * np.cos(angle), apart * np.sin(angle), rng.uniform(-0.5, 0.5)])
        return np.stack([np.zeros(3), away])
    side = _NEIGHBOUR_M * np.sqrt(robots)
    while True:
        centre = rng.uniform(0, 1, (robots, 3)) * np.array([side, side, 1.0])
        apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
        tied = np.linalg.matrix_power((apart < reach_m).astype(float) / robots, robots)
        if (tied > 0).all() and (apart + 9 * np.eye(robots)).min() > 1.0:
            return centre


def draw_team(rng: np.random.Generator, case: Case, noise: Noise) -> SimulatedTeam:
    """One team of a case."""
    photo_at = np.linspace(0, case.samples - 1, 11).astype(int)
    centre = _centres(rng, case.robots, noise.radio_reach_m)
    drift = noise if case.drifting else None
    robots = tuple(
        _robot(rng, f"robot{k:02d}", centre[k], case.samples, photo_at, drift) for k in range(case.robots)
    )
    bearings, ranges = [], []
    for a in range(case.robots):
        for b in range(a + 1, case.robots):
            if case.robots > 2 and np.linalg.norm(centre[a] - centre[b]) >= noise.radio_reach_m:
                continue
            for i in sorted(rng.choice(case.samples, case.meetings, replace=False).tolist()):
                for at in ((a, b, i), (b, a, i)):
                    told = told_share(case.outlier_share)
                    ends = robots[at[0]], robots[at[1]]
                    sigma_rad = np.deg2rad(noise.bearing_deg)
                    drawn = drawn_bearing(rng, *ends, i, sigma_rad, case.outlier_share, told)
                    bearings.append((*drawn, at))
                ranges.append((*_range(rng, robots[a], robots[b], i, noise, case.outlier_share), (a, b, i)))
    return SimulatedTeam(
        robots,
        tuple(entry[0] for entry in bearings),
        tuple(entry[0] for entry in ranges),
        np.array([entry[2] for entry in bearings]),
        np.array([entry[2] for entry in ranges]),
        np.array([entry[1] for entry in bearings]),
        np.array([entry[1] for entry in ranges]),
        photo_at,
    )
