"""From a mission to every robot's poses in one frame, with covariance."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.linalg import block_diag

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.interpolation import Between, pose_between
from mulan.localization.odometry_learning import LearnedOdometry, learn_odometry
from mulan.localization.photograph_factor import photograph_factor
from mulan.localization.relative_poses import relative_poses
from mulan.localization.solve import refine_solution
from mulan.localization.trust import solve_trusting
from mulan.localization.types import Localization, PosedTrajectory
from mulan.mission.photograph_information import PhotographInformation
from mulan.mission.types import Mission, RobotLog
from mulan.wireless.bearing import BearingConfig, estimate_bearings
from mulan.wireless.ranging import thin_ranges
from mulan.wireless.types import Bearing, Range


class _TeamPoses:
    """Every placed robot's pose at any instant."""

    def __init__(
        self, robots: Sequence[RobotLog], learned: LearnedOdometry, config: LocalizationConfig
    ) -> None:
        self._logs = {robot.name: robot for robot in robots}
        self._learned, self._config = learned, config
        graph, values = learned.graph, learned.solution.values
        self.T_world_keyframe: dict[str, Float[NDArray, "n 4 4"]] = {
            name: np.array(
                [values.atPose3(graph.key(name, i)).matrix() for i in range(len(keyframes.time_s))]
            )
            for name, keyframes in graph.robots.items()
        }

    def at(self, name: str, time_s: float) -> Between:
        return pose_between(
            self._logs[name],
            self._learned.graph.robots[name],
            self.T_world_keyframe[name],
            time_s,
            self._config,
        )

    def trajectory(self, name: str, time_s: Float[NDArray, "n"]) -> PosedTrajectory:
        joint = self._learned.marginals.joint
        poses = [self.at(name, float(t)) for t in time_s]
        covariance = [pose.covariance(lambda indices: joint([(name, i) for i in indices])) for pose in poses]
        return PosedTrajectory(
            name,
            time_s,
            np.array([pose.T_world_body for pose in poses], dtype=float).reshape(-1, 4, 4),
            np.array(covariance, dtype=float).reshape(-1, 6, 6),
        )

    def joint_covariance(self, photographs: Sequence[tuple[str, float]]) -> Float[NDArray, "d d"]:
        """Covariance of poses at many instants (robot, time) together, six rows each."""
        poses = [self.at(name, time_s) for name, time_s in photographs]
        beside = [
            (name, int(i)) for (name, _), pose in zip(photographs, poses, strict=True) for i in pose.indices
        ]
        unique = list(dict.fromkeys(beside))
        row = {keyframe: 6 * i for i, keyframe in enumerate(unique)}
        J, own = np.zeros((6 * len(poses), 6 * len(unique))), np.zeros((len(poses), 6, 6))
        for i, pose in enumerate(poses):
            own[i] = pose.own_covariance
            for keyframe, by in zip(beside[2 * i : 2 * i + 2], (pose.by_before, pose.by_after), strict=True):
                # at a keyframe both are the same one and the second derivative is zero
                J[6 * i : 6 * i + 6, row[keyframe] : row[keyframe] + 6] += by
        return J @ self._learned.marginals.joint_of_many(unique) @ J.T + np.asarray(block_diag(*own))


def localize_from_measurements(
    robots: Sequence[RobotLog],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    config: LocalizationConfig,
    progress: Callable[[int, int, str], None] | None = None,
    photographs: PhotographInformation | None = None,
) -> Localization:
    """Poses from bearings and ranges already at hand; the first robot is the anchor.

    Robots that cannot be placed yet are listed in the result with what they lack; the others are solved
    without them. What refined photographs say joins the graph once the team is placed: they cannot place
    it, since all cameras moved alike see the same.

    Raises:
        InputError: A robot's photographs lie outside its odometry, or the refined ones are not the mission's.
    """
    trusted = solve_trusting(robots, bearings, ranges, config, progress)
    placed = [robot for robot in robots if robot.name in trusted.graph.robots]
    graph, solution = trusted.graph, trusted.solution
    if photographs is not None:
        key_of = {name: graph.key(name, 0) for name in graph.robots}
        graph = replace(graph, photographs=photograph_factor(photographs, robots, graph.robots, key_of))
        solution = refine_solution(graph, solution)
    learned = learn_odometry(placed, graph, solution)
    poses = _TeamPoses(placed, learned, config)
    bearing_inlier = np.zeros(len(trusted.bearings))
    bearing_inlier[trusted.is_kept] = learned.solution.bearing_inlier
    instants = [(robot.name, float(t)) for robot in placed for t in robot.photo_time_s]
    joint = None
    if 0 < len(instants) <= config.most_joint_photographs:
        joint = poses.joint_covariance(instants)
    return Localization(
        anchor=robots[0].name,
        trajectories={robot.name: poses.trajectory(robot.name, robot.photo_time_s) for robot in placed},
        T_world_odom={
            name: poses.T_world_keyframe[name][0] @ se3.inverse(keyframes.T_odom_body[0])
            for name, keyframes in learned.graph.robots.items()
        },
        bearings=trusted.bearings,
        bearing_inlier=bearing_inlier,
        ranges=trusted.ranges,
        cost=learned.solution.cost,
        undetermined=trusted.undetermined,
        suspects=trusted.suspects,
        relative_poses=relative_poses(placed, trusted.bearings, poses.at, learned.marginals.joint_of_many),
        odometry=learned.corrections,
        joint_covariance=joint,
    )


def localize(
    mission: Mission,
    config: LocalizationConfig,
    bearing_config: BearingConfig,
    progress: Callable[[int, int, str], None] | None = None,
    photographs: PhotographInformation | None = None,
) -> Localization:
    """Every robot's photograph poses in the anchor's start frame, from what the mission recorded.

    Args:
        mission: The logs; ground truth is not read.
        config: Graph options.
        bearing_config: Radio options.
        progress: Called with (done, total, what).
        photographs: What refining the photographs' poses said, if they were.

    Raises:
        InputError: A recording is unusable; says which and why. Robots that cannot be placed are no error:
            they are listed in the result.
    """
    if not mission.robots:
        raise InputError("mission", "robots", "there are none", "record at least one robot")
    bearings = estimate_bearings(mission.robots, bearing_config, progress)
    ranges = thin_ranges(mission.robots, config.ranging)
    return localize_from_measurements(mission.robots, bearings, ranges, config, progress, photographs)
