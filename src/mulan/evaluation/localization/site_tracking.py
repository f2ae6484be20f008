"""Robots tracked by ranges between antennas of known place: many antennas on one body, fixed or moving.

The site's antennas hang on a body that does not move, so the mission's factor graph and its robust solution
serve unchanged; only the measurements are hung on antennas instead of on one antenna a robot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mulan.geometry import se3, so3
from mulan.localization.factors import Sight
from mulan.localization.graph import LocalizationConfig, LocalizationGraph, RangeNode
from mulan.localization.keyframes import Keyframes
from mulan.localization.solve import solve_graph
from mulan.wireless.types import Range

SITE = "site"
_FIRST_BIAS_KEY = 10**15
_TILT_SIGMA_RAD = np.deg2rad(1.0)
_ROBUST_M = 0.3
_HEADINGS = 12


@dataclass(frozen=True)
class Antenna:
    """Where a radio sits: on which body, at which point of it [m]."""

    body: str
    at_body_m: Float[NDArray, "3"]


@dataclass(frozen=True)
class Tracked:
    """One robot's planar poses with covariance over (x, y, yaw) in the site's axes."""

    time_s: Float[NDArray, "n"]
    T_site_body: Float[NDArray, "n 4 4"]
    covariance: Float[NDArray, "n 3 3"]


def site_keyframes() -> Keyframes:
    """The body that holds the fixed antennas; it defines the axes, and its height is the robots' floor."""
    return Keyframes(SITE, np.zeros(1), np.eye(4)[None], np.zeros((0, 6, 6)), np.array([1e-8]))


def wandering_keyframes(
    name: str, time_s: Float[NDArray, "n"], walk_m_per_sqrt_s: float, turn_rad_per_sqrt_s: float
) -> Keyframes:
    """A robot without odometry: it stands still, give or take a random walk in the plane."""
    step_s = np.diff(time_s)
    covariance = np.zeros((len(step_s), 6, 6))
    tilt = 2 * _TILT_SIGMA_RAD**2
    covariance[:, [0, 1], [0, 1]] = tilt
    covariance[:, 2, 2] = turn_rad_per_sqrt_s**2 * step_s
    covariance[:, [3, 4], [3, 4]] = walk_m_per_sqrt_s**2 * step_s[:, None]
    covariance[:, 5, 5] = 0.01**2
    poses = np.tile(np.eye(4), (len(time_s), 1, 1))
    return Keyframes(name, time_s, poses, covariance, np.full(len(time_s), _TILT_SIGMA_RAD**2))


def tracking_graph(
    bodies: Mapping[str, Keyframes],
    antennas: Mapping[str, Antenna],
    ranges: Sequence[Range],
    config: LocalizationConfig,
) -> LocalizationGraph:
    """Ranges between antennas, each hung on the nearest keyframes; every link has a bias of its own."""
    links = sorted({(r.observer, r.peer) for r in ranges})
    bias_key = {link: _FIRST_BIAS_KEY + i for i, link in enumerate(links)}
    graph = LocalizationGraph(bodies, (), (), tuple(bias_key.values()), config)

    def end(name: str, time_s: float) -> tuple[int, Float[NDArray, "3"]]:
        antenna = antennas[name]
        return graph.key(antenna.body, bodies[antenna.body].nearest(time_s)), antenna.at_body_m

    nodes = []
    for r in ranges:
        (i, a), (j, b) = end(r.observer, r.time_s), end(r.peer, r.time_s)
        nodes.append(RangeNode(r, Sight(i, j, a, b), bias_key[r.observer, r.peer]))
    return replace(graph, ranges=tuple(nodes))


def planar(x_m: float, y_m: float, yaw_rad: float) -> Float[NDArray, "4 4"]:
    """A level pose at height zero."""
    return se3.from_parts(so3.about_z(np.array(yaw_rad)), np.array([x_m, y_m, 0.0]))


def placed(
    antennas: Mapping[str, Antenna],
    ranges: Sequence[Range],
    T_odom_body: Mapping[float, Float[NDArray, "4 4"]],
    near: Float[NDArray, "3"] | None,
) -> Float[NDArray, "3"]:
    """Start frame (x, y, yaw) of one robot from ranges to fixed antennas, robustly, from many headings.

    Args:
        antennas: Fixed ones and the robot's.
        ranges: To fixed antennas only.
        T_odom_body: The robot's dead reckoning at each range's time.
        near: A guess of the place; without one starts lie around the fixed antennas, at many headings.
    """
    fixed, moving, measured = [], [], []
    for r in ranges:
        ends = [antennas[r.observer], antennas[r.peer]]
        own = ends[1] if ends[0].body == SITE else ends[0]
        fixed.append((ends[0] if ends[0].body == SITE else ends[1]).at_body_m)
        moving.append(se3.transform(T_odom_body[r.time_s], own.at_body_m))
        measured.append(r.range_m)
    at, odom, range_m = np.array(fixed), np.array(moving), np.array(measured)

    def residual(x: Float[NDArray, "3"]) -> Float[NDArray, "n"]:
        T = planar(*x)
        return np.linalg.norm(odom @ T[:3, :3].T + T[:3, 3] - at, axis=1) - range_m

    headings = np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False)
    starts = [] if near is None else [near, *(np.array([near[0], near[1], yaw]) for yaw in headings[::2])]
    if near is None:
        middle, spread = at[:, :2].mean(0), at[:, :2].std(0).max()
        offsets = spread * np.array([[0.0, 0.0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        starts = [np.array([*(middle + offset), yaw]) for offset in offsets for yaw in headings]
    found = [
        least_squares(residual, start, loss="soft_l1", f_scale=_ROBUST_M, max_nfev=40) for start in starts
    ]
    return np.asarray(min(found, key=lambda fit: fit.cost).x)


def solved(graph: LocalizationGraph, initial: Mapping[str, Float[NDArray, "n 4 4"]]) -> Mapping[str, Tracked]:
    """Poses of all moving bodies from initial ones, robustly."""
    values = gtsam.Values()
    values.insert(graph.key(SITE, 0), gtsam.Pose3(np.eye(4)))
    for name, poses in initial.items():
        for i, T in enumerate(poses):
            values.insert(graph.key(name, i), gtsam.Pose3(T))
    for key in graph.bias_keys:
        values.insert(key, np.zeros(1))
    solution = solve_graph(graph, values)
    marginals = gtsam.Marginals(solution.graph, solution.values)
    tracked = {}
    for name in initial:
        keys = [graph.key(name, i) for i in range(len(graph.robots[name].time_s))]
        T = np.array([solution.values.atPose3(key).matrix() for key in keys])
        own_axes = np.array([marginals.marginalCovariance(key) for key in keys])
        tracked[name] = Tracked(graph.robots[name].time_s, T, planar_covariance(T, own_axes))
    return tracked


def planar_covariance(
    T: Float[NDArray, "n 4 4"], covariance: Float[NDArray, "n 6 6"]
) -> Float[NDArray, "n 3 3"]:
    """Over (x, y, yaw) in the world's axes, from that of a right perturbation."""
    R = T[:, :3, :3]
    J = np.zeros((len(T), 3, 6))
    J[:, :2, 3:] = R[:, :2]
    J[:, 2, :3] = R[:, 2]
    return J @ covariance @ np.swapaxes(J, 1, 2)
