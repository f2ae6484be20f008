"""Bearings and ranges drawn on the true motion of recorded flights."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.mission.types import RobotLog
from mulan.wireless.directions import tangent_basis
from mulan.wireless.types import Bearing, Range

Instants = Mapping[tuple[str, str], Float[NDArray, "n"]]
"""Times of each pair of robots."""


@dataclass(frozen=True)
class DrawnRadioConfig:
    """What the radios measure and how often."""

    bearing_every_s: float = 2.0
    """One mutual bearing (both directions) a pair in this time: one aperture after another. The apertures of
    the WSR recordings are 0.7 m long, and the flights make 0.4 to 0.9 m/s."""
    bearing_sigma_deg: float = 5.0
    """Standard deviation of a bearing's right direction, each axis."""
    hypothesis_weights: tuple[float, ...] = (0.8, 0.15)
    """Directions a bearing reports, with the probability that each is the right one."""
    range_rate_hz: float = 2.0
    """Ranges a second and pair, as many as thinning keeps of a UWB radio's."""
    range_sigma_m: float = 0.05
    """Standard deviation of a range."""
    range_bias_sigma_m: float = 0.03
    """Constant offset of a pair of radios, one sigma."""
    nearest_m: float = 0.5
    """Closer antennas measure no bearing."""


def true_pose(robot: RobotLog, time_s: float) -> Float[NDArray, "4 4"]:
    """The body in the frame of the ground truth."""
    assert robot.ground_truth is not None
    truth = robot.ground_truth
    return se3.interpolate(truth.time_s, truth.T_world_body, np.array([time_s]))[0]


def _anywhere(rng: np.random.Generator) -> Float[NDArray, "3"]:
    u = rng.normal(size=3)
    return u / np.linalg.norm(u)


def draw_bearing(
    rng: np.random.Generator, observer: RobotLog, peer: RobotLog, time_s: float, config: DrawnRadioConfig
) -> Bearing | None:
    """A mixture whose claims are true: each hypothesis is right as often as its weight says."""
    T_observer, T_peer = true_pose(observer, time_s), true_pose(peer, time_s)
    v = T_peer[:3, 3] - T_observer[:3, 3]
    if np.linalg.norm(v) < config.nearest_m:
        return None
    T_odom = se3.interpolate(observer.odometry.time_s, observer.odometry.T_odom_body, np.array([time_s]))[0]
    u = T_odom[:3, :3] @ T_observer[:3, :3].T @ (v / np.linalg.norm(v))
    sigma = np.deg2rad(config.bearing_sigma_deg)
    u = u + tangent_basis(u) @ (np.tan(sigma * rng.normal(size=2)))
    directions = [_anywhere(rng) for _ in config.hypothesis_weights]
    outlier_mass = 1 - sum(config.hypothesis_weights)
    right = rng.choice(len(directions) + 1, p=[*config.hypothesis_weights, outlier_mass])
    if right < len(directions):
        directions[right] = u / np.linalg.norm(u)
    return Bearing(
        observer=observer.name,
        peer=peer.name,
        time_s=time_s,
        peer_time_s=time_s,
        T_odom_body=T_odom,
        direction_odom=np.array(directions),
        tangent_covariance=np.tile(sigma**2 * np.eye(2), (len(directions), 1, 1)),
        weight=np.array(config.hypothesis_weights),
        outlier_mass=outlier_mass,
        kappa_paper=1e5,
        packets=300,
    )


def draw_range(
    rng: np.random.Generator,
    observer: RobotLog,
    peer: RobotLog,
    time_s: float,
    bias_m: float,
    config: DrawnRadioConfig,
) -> Range:
    """True distance, the pair's bias and noise."""
    apart = true_pose(observer, time_s)[:3, 3] - true_pose(peer, time_s)[:3, 3]
    measured_m = float(np.linalg.norm(apart)) + bias_m + config.range_sigma_m * rng.normal()
    return Range(observer.name, peer.name, time_s, max(measured_m, 0.01), config.range_sigma_m)


def draw_radio(
    rng: np.random.Generator,
    robots: Mapping[str, RobotLog],
    bearing_s: Instants,
    range_s: Instants,
    config: DrawnRadioConfig,
) -> tuple[list[Bearing], list[Range]]:
    """Mutual bearings (both directions at one instant) and ranges of all pairs at the instants given."""
    bearings: list[Bearing] = []
    ranges: list[Range] = []
    for (first, second), instants in bearing_s.items():
        for t in instants:
            for observer, peer in ((first, second), (second, first)):
                bearing = draw_bearing(rng, robots[observer], robots[peer], float(t), config)
                bearings.extend([bearing] if bearing else [])
    for (first, second), instants in range_s.items():
        bias_m = config.range_bias_sigma_m * rng.normal()
        ranges.extend(
            draw_range(rng, robots[first], robots[second], float(t), bias_m, config) for t in instants
        )
    return bearings, ranges
