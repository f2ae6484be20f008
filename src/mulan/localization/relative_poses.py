"""Where robots are in each other's body frames, with the covariance their shared measurements leave."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.interpolation import Between
from mulan.localization.keyframes import clock_offset_s
from mulan.localization.types import RelativePose
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing

_INSTANTS = 5
_LARGE_TEAM = 10  # its many pairs are given at the end of the mission only

PoseAt = Callable[[str, float], Between]
"""A robot's pose between its keyframes."""
TeamCovariance = Callable[[list[tuple[str, int]]], Float[NDArray, "d d"]]
"""Covariance of several keyframes (robot, index) together, in the order given."""


def relative_poses(
    robots: Sequence[RobotLog], bearings: Sequence[Bearing], pose_at: PoseAt, covariance: TeamCovariance
) -> tuple[RelativePose, ...]:
    """Every pair of robots at instants spread over the time both recorded; pairs that never met are left out.

    Args:
        robots: The placed ones.
        bearings: Tell the offset between two robots' clocks.
        pose_at: Of a robot at an instant on its clock.
        covariance: Of keyframes together.
    """
    pairs = []
    for robot, peer in combinations(robots, 2):
        offset_s = clock_offset_s(robot.name, peer.name, bearings)
        begin = max(robot.odometry.time_s[0], peer.odometry.time_s[0] - offset_s)
        end = min(robot.odometry.time_s[-1], peer.odometry.time_s[-1] - offset_s)
        if end < begin:
            continue
        count = _INSTANTS if len(robots) <= _LARGE_TEAM else 1
        for time_s in np.linspace(end, begin, count)[::-1]:
            pairs.append(_Pair.at(robot.name, peer.name, float(time_s), float(time_s + offset_s), pose_at))
    keyframes = list(dict.fromkeys(keyframe for pair in pairs for keyframe in pair.by_keyframe))
    if not keyframes:
        return ()
    # one solve for all of them; a pair by itself costs an elimination of the whole graph
    joint = covariance(keyframes)
    row = {keyframe: 6 * i for i, keyframe in enumerate(keyframes)}
    return tuple(pair.relative_pose(joint, row) for pair in pairs)


@dataclass(frozen=True)
class _Pair:
    """Two robots at one instant, and how their relative pose moves with keyframes beside it."""

    robot: str
    peer: str
    time_s: float
    peer_time_s: float
    T_robot_peer: Float[NDArray, "4 4"]
    own_covariance: Float[NDArray, "6 6"]
    by_keyframe: Mapping[tuple[str, int], Float[NDArray, "6 6"]]

    @classmethod
    def at(cls, robot: str, peer: str, time_s: float, peer_time_s: float, pose_at: PoseAt) -> "_Pair":
        """``T_robot_peer = T_world_robot⁻¹ T_world_peer`` at an instant of each one's clock."""
        first, second = pose_at(robot, time_s), pose_at(peer, peer_time_s)
        T = se3.inverse(first.T_world_body) @ second.T_world_body
        by_first = -se3.adjoint(se3.inverse(T))
        terms: dict[tuple[str, int], Float[NDArray, "6 6"]] = {}
        for name, pose, by_pose in ((robot, first, by_first), (peer, second, np.eye(6))):
            for index, by_keyframe in zip(pose.indices, (pose.by_before, pose.by_after), strict=True):
                key = (name, int(index))
                terms[key] = terms.get(key, np.zeros((6, 6))) + by_pose @ by_keyframe
        own = by_first @ first.own_covariance @ by_first.T + second.own_covariance
        return cls(robot, peer, time_s, peer_time_s, T, own, terms)

    def relative_pose(self, joint: Float[NDArray, "d d"], row: Mapping[tuple[str, int], int]) -> RelativePose:
        """With the covariance that the keyframes' joint one leaves."""
        rows = np.concatenate([np.arange(row[keyframe], row[keyframe] + 6) for keyframe in self.by_keyframe])
        J = np.concatenate(list(self.by_keyframe.values()), axis=1)
        covariance = J @ joint[np.ix_(rows, rows)] @ J.T + self.own_covariance
        return RelativePose(
            self.robot, self.peer, self.time_s, self.peer_time_s, self.T_robot_peer, covariance
        )
