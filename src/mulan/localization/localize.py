"""From a mission to every robot's poses in one frame, with covariance."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig, LocalizationGraph, build_graph
from mulan.localization.graph_covariances import GraphCovariances
from mulan.localization.initialization import initial_alignment
from mulan.localization.solve import Solution, solve_graph
from mulan.localization.types import Localization, PosedTrajectory
from mulan.mission.types import Mission, RobotLog
from mulan.wireless.bearing import BearingConfig, estimate_bearings
from mulan.wireless.ranging import thin_ranges
from mulan.wireless.types import Bearing, Range


def _trajectories(
    robots: Sequence[RobotLog], graph: LocalizationGraph, solution: Solution
) -> Mapping[str, PosedTrajectory]:
    marginals = GraphCovariances(solution.graph, solution.values, solution.other_modes)
    trajectories = {}
    for robot in robots:
        photo_s = robot.photo_time_s
        keyframes = graph.robots[robot.name]
        keys = [graph.key(robot.name, keyframes.nearest(t)) for t in photo_s]
        poses = [solution.values.atPose3(key).matrix() for key in keys]
        covariance = [marginals.covariance(key) for key in keys]
        trajectories[robot.name] = PosedTrajectory(
            robot.name,
            photo_s,
            np.array(poses, dtype=float).reshape(-1, 4, 4),
            np.array(covariance, dtype=float).reshape(-1, 6, 6),
        )
    return trajectories


def localize_from_measurements(
    robots: Sequence[RobotLog],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    config: LocalizationConfig,
    progress: Callable[[int, int, str], None] | None = None,
) -> Localization:
    """Poses from bearings and ranges already at hand; the first robot is the anchor.

    Raises:
        InputError: A robot cannot be placed, or its photographs lie outside its odometry.
    """
    start = initial_alignment(
        robots, bearings, ranges, config.initialization, config.gravity_aligned, config.common_floor_sigma_m
    )
    graph = build_graph(robots, bearings, ranges, config)
    solution = solve_graph(graph, graph.initial(start), progress)
    T_world_odom = {}
    for name, keyframes in graph.robots.items():
        first = solution.values.atPose3(graph.key(name, 0)).matrix()
        T_world_odom[name] = first @ se3.inverse(keyframes.T_odom_body[0])
    return Localization(
        anchor=robots[0].name,
        trajectories=_trajectories(robots, graph, solution),
        T_world_odom=T_world_odom,
        bearings=tuple(bearings),
        bearing_inlier=solution.bearing_inlier,
        ranges=tuple(ranges),
        cost=solution.cost,
    )


def localize(
    mission: Mission,
    config: LocalizationConfig,
    bearing_config: BearingConfig,
    progress: Callable[[int, int, str], None] | None = None,
) -> Localization:
    """Every robot's photograph poses in the anchor's start frame, from what the mission recorded.

    Args:
        mission: The logs; ground truth is not read.
        config: Graph options.
        bearing_config: Radio options.
        progress: Called with (done, total, what).

    Raises:
        InputError: A recording is unusable or a robot cannot be placed; says which and why.
    """
    if not mission.robots:
        raise InputError("mission", "robots", "there are none", "record at least one robot")
    bearings = estimate_bearings(mission.robots, bearing_config, progress)
    ranges = thin_ranges(mission.robots, config.ranging)
    return localize_from_measurements(mission.robots, bearings, ranges, config, progress)
