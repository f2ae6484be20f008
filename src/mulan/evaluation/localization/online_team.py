"""A team that drives for an hour: drifting odometry at a steady rate, and radio drawn from the truth."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.localization.drawn_bearing import drawn_bearing
from mulan.geometry import se3, so3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import OdometryTrack, PoseTrack, RobotLog
from mulan.wireless.types import Bearing, Range

_WIFI_BODY_M = np.array([0.1, 0.0, 0.05])
_UWB_BODY_M = np.array([0.0, 0.1, 0.02])


@dataclass(frozen=True)
class OnlineTeamConfig:
    """How the team moves and measures."""

    robots: int = 5
    """Robots."""
    hours: float = 1.0
    """Length of the mission."""
    keyframe_s: float = 1.0
    """Between keyframes."""
    radio_s: float = 10.0
    """Between two radio measurements of one pair: a bearing in each direction and a range."""
    sigma_rad: float = np.deg2rad(5.0)
    """Of bearings, each axis."""
    sigma_m: float = 0.05
    """Of ranges."""
    bias_m: float = 0.03
    """Of each pair's constant range offset."""
    outliers: float = 0.05
    """Share of bearings in any direction and of ranges over a detour."""
    yaw_deg_per_sqrt_m: float = 0.5
    """Drift of the heading, degrees after one metre."""
    translation_percent: float = 1.0
    """Drift of the position, each axis."""
    hall_m: float = 12.0
    """Side of the hall the team wanders in."""
    rest_s: float = 0.0
    """Each robot drives for so long, then stands as long; none means it never stands."""


def make_online_team(rng: np.random.Generator, config: OnlineTeamConfig) -> tuple[RobotLog, ...]:
    """Robots with drifting odometry, its covariance, and ground truth in one frame."""
    count = max(2, round(3600 * config.hours / config.keyframe_s) + 1)
    time_s = config.keyframe_s * np.arange(count)
    camera = PinholeCamera(40, 30, 30.0, 30.0, 20.0, 15.0)
    robots = []
    for i in range(config.robots):
        T = _wander(rng, time_s, config)
        T_odom, covariance = _dead_reckoning(rng, T, config)
        robots.append(
            RobotLog(
                name=f"robot{i + 1:02d}",
                camera=camera,
                T_body_camera=np.eye(4),
                wifi_antenna_body_m=_WIFI_BODY_M,
                uwb_antenna_body_m=_UWB_BODY_M,
                photos=(),
                odometry=OdometryTrack(time_s, T_odom, covariance),
                csi={},
                ranges={},
                ground_truth=PoseTrack(time_s, T),
            )
        )
    return tuple(robots)


def _wander(
    rng: np.random.Generator, time_s: Float[NDArray, "n"], config: OnlineTeamConfig
) -> Float[NDArray, "n 4 4"]:
    """A smooth walk through the hall, about 0.3 m/s, the body facing ahead."""
    phase, slow = rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.7, 1.3, 6)
    along_s = time_s
    if config.rest_s > 0:
        driving = np.floor(time_s / config.rest_s + rng.uniform(0, 2)) % 2 == 0
        along_s = np.concatenate([[0.0], np.cumsum(np.diff(time_s) * driving[1:])])
    frequency = np.array([0.031, 0.083, 0.037, 0.071, 0.05, 0.11]) * slow
    angle = frequency[:, None] * along_s + phase[:, None]
    wave, speed = np.sin(angle), frequency[:, None] * np.cos(angle)
    side = config.hall_m / 2
    x, y = side * (0.7 * wave[0] + 0.3 * wave[1]), side * (0.7 * wave[2] + 0.3 * wave[3])
    z = 0.6 * (0.7 * wave[4] + 0.3 * wave[5])
    yaw = np.unwrap(np.arctan2(0.7 * speed[2] + 0.3 * speed[3], 0.7 * speed[0] + 0.3 * speed[1]))
    return se3.from_parts(so3.about_z(yaw), np.stack([x, y, z], -1))


def _dead_reckoning(
    rng: np.random.Generator, T: Float[NDArray, "n 4 4"], config: OnlineTeamConfig
) -> tuple[Float[NDArray, "n 4 4"], Float[NDArray, "n 6 6"]]:
    steps = se3.inverse(T[:-1]) @ T[1:]
    metres = np.linalg.norm(steps[:, :3, 3], axis=1)
    walk = np.array([1e-5, 1e-5, np.deg2rad(config.yaw_deg_per_sqrt_m)])
    walk = np.concatenate([walk, np.full(3, config.translation_percent / 100)])
    sigma = walk * np.sqrt(metres)[:, None]
    noisy = steps @ se3.exp(sigma * rng.normal(size=sigma.shape))
    T_odom = np.empty_like(T)
    covariance = np.zeros((len(T), 6, 6))
    T_odom[0] = np.eye(4)
    for i in range(len(steps)):
        T_odom[i + 1] = T_odom[i] @ noisy[i]
        carried = se3.covariance_of_composition(noisy[i], covariance[i])
        covariance[i + 1] = carried + np.diag(sigma[i] ** 2)
    return T_odom, covariance


@dataclass(frozen=True)
class TrueRadio:
    """Draws what two robots' radios would report at a keyframe."""

    config: OnlineTeamConfig
    bias_m: Float[NDArray, "n n"]

    @staticmethod
    def draw(rng: np.random.Generator, config: OnlineTeamConfig) -> "TrueRadio":
        """With a constant offset for each pair."""
        return TrueRadio(config, config.bias_m * rng.normal(size=(config.robots, config.robots)))

    def bearing(self, rng: np.random.Generator, observer: RobotLog, peer: RobotLog, i: int) -> Bearing:
        """A direction, wrong with the configured probability."""
        return drawn_bearing(rng, observer, peer, i, self.config.sigma_rad, self.config.outliers)[0]

    def range(self, rng: np.random.Generator, robots: tuple[RobotLog, ...], a: int, b: int, i: int) -> Range:
        """A distance, over a detour with the configured probability."""
        ends = [se3.transform(_truth(robots[k], i), _UWB_BODY_M) for k in (a, b)]
        d = float(np.linalg.norm(ends[0] - ends[1])) + self.bias_m[a, b] + self.config.sigma_m * rng.normal()
        if rng.random() < self.config.outliers:
            d += rng.exponential(2.0)
        time_s = float(robots[a].odometry.time_s[i])
        return Range(robots[a].name, robots[b].name, time_s, max(d, 0.1), self.config.sigma_m)


def _truth(robot: RobotLog, i: int) -> Float[NDArray, "4 4"]:
    assert robot.ground_truth is not None
    return robot.ground_truth.T_world_body[i]


def pairs_due(robots: int, i: int, every: int) -> list[tuple[int, int]]:
    """Pairs that measure at a keyframe: each once every so many keyframes, taking turns on the channel."""
    pairs = [(a, b) for a in range(robots) for b in range(a + 1, robots)]
    return [pair for k, pair in enumerate(pairs) if (i - k) % every == 0]
