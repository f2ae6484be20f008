"""Poses between keyframes: the odometry in between, held by the keyframes on both sides."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.keyframes import Keyframes, OdometryNoise, make_keyframes
from mulan.mission.types import RobotLog

_AT_A_KEYFRAME_S = 1e-6

JointCovariance = Callable[[list[int]], Float[NDArray, "d d"]]
"""Covariance of several keyframes of one robot together, by index."""


@dataclass(frozen=True)
class Between:
    """A pose as a function of the keyframes beside it.

    Attributes:
        indices: The keyframe before and the one after; the same twice at a keyframe or off either end.
        T_world_body: The pose.
        by_before, by_after: Its derivative by perturbations of the two keyframes.
        own_covariance: What remains open when both are known exactly.
    """

    indices: Int[NDArray, "2"]
    T_world_body: Float[NDArray, "4 4"]
    by_before: Float[NDArray, "6 6"]
    by_after: Float[NDArray, "6 6"]
    own_covariance: Float[NDArray, "6 6"]

    def covariance(self, joint: JointCovariance) -> Float[NDArray, "6 6"]:
        """Marginal covariance of the pose."""
        before, after = (int(i) for i in self.indices)
        if before == after:
            return self.by_before @ joint([before]) @ self.by_before.T + self.own_covariance
        J = np.concatenate([self.by_before, self.by_after], axis=1)
        return J @ joint([before, after]) @ J.T + self.own_covariance


def pose_between(
    robot: RobotLog,
    keyframes: Keyframes,
    T_world_keyframe: Float[NDArray, "n 4 4"],
    time_s: float,
    config: LocalizationConfig,
) -> Between:
    """The most probable pose at an instant, given the keyframes on both sides and the odometry in between.

    The odometry of the whole gap disagrees with the two keyframes by some closure error; the part of it that
    belongs before the instant is its regression on it, from the covariances of the two pieces. Where roll and
    pitch are known, the vertical the odometry felt at the instant is counted in as it is at every keyframe.

    Args:
        robot: Odometry.
        keyframes: The robot's keyframes in the graph.
        T_world_keyframe: Their optimised poses.
        time_s: Instant; outside the odometry its ends are held.
        config: The graph's.
    """
    noise, gravity_aligned = config.odometry_noise, config.gravity_aligned
    stamps = keyframes.time_s
    time_s = float(np.clip(time_s, robot.odometry.time_s[0], robot.odometry.time_s[-1]))
    nearest = keyframes.nearest(time_s)
    if abs(stamps[nearest] - time_s) < _AT_A_KEYFRAME_S:
        at = np.array([nearest, nearest])
        return Between(at, T_world_keyframe[nearest], np.eye(6), np.zeros((6, 6)), np.zeros((6, 6)))
    after = int(np.searchsorted(stamps, time_s))
    if after == 0 or after == len(stamps):
        pieces = _pieces(robot, keyframes, sorted([stamps[nearest], time_s]), noise, gravity_aligned, None)
        return _beyond(pieces, nearest, T_world_keyframe[nearest], bool(time_s < stamps[nearest]))
    before = after - 1
    gap = stamps[after] - stamps[before]
    fraction = np.array([time_s - stamps[before], stamps[after] - time_s]) / gap
    pieces = _pieces(
        robot, keyframes, [stamps[before], time_s, stamps[after]], noise, gravity_aligned, fraction
    )
    steps = se3.inverse(pieces.T_odom_body[:-1]) @ pieces.T_odom_body[1:]
    T_before, T_after = T_world_keyframe[before], T_world_keyframe[after]
    apart = se3.inverse(T_before) @ T_after
    closure = se3.log(se3.inverse(steps[0] @ steps[1]) @ apart)
    first, second = pieces.step_covariance
    carried = se3.adjoint(se3.inverse(steps[1]))
    gain = np.linalg.solve(carried @ first @ carried.T + second, carried @ first).T
    own = first - gain @ carried @ first
    T = T_before @ steps[0] @ se3.exp(gain @ closure)
    from_before = se3.inverse(T_before) @ T
    by_before = se3.adjoint(se3.inverse(from_before)) - gain @ se3.adjoint(se3.inverse(apart))
    result = Between(np.array([before, after]), T, by_before, gain, (own + own.T) / 2)
    return _levelled(result, pieces, 1, np.deg2rad(config.gravity_sigma_deg)) if gravity_aligned else result


def _pieces(
    robot: RobotLog,
    keyframes: Keyframes,
    time_s: list[float],
    noise: OdometryNoise,
    gravity_aligned: bool,
    fraction: Float[NDArray, "m"] | None,
) -> Keyframes:
    """The odometry around the instant, corrected as the graph's is.

    Scaled about its own start instead of the robot's: only steps are taken from it.
    """
    return make_keyframes(
        robot, np.array(time_s), noise, gravity_aligned, fraction, correction=keyframes.correction
    )


def _beyond(
    pieces: Keyframes, index: int, T_world_keyframe: Float[NDArray, "4 4"], is_early: bool
) -> Between:
    """Before the first keyframe or after the last: dead reckoning from it."""
    at = np.array([index, index])
    T_early_late = se3.inverse(pieces.T_odom_body[0]) @ pieces.T_odom_body[1]
    if not is_early:
        by = se3.adjoint(se3.inverse(T_early_late))
        T, own = T_world_keyframe @ T_early_late, pieces.step_covariance[0]
        return Between(at, T, by, np.zeros((6, 6)), own)
    by = se3.adjoint(T_early_late)
    own = by @ pieces.step_covariance[0] @ by.T
    return Between(at, T_world_keyframe @ se3.inverse(T_early_late), by, np.zeros((6, 6)), own)


def _levelled(pose: Between, pieces: Keyframes, index: int, gravity_sigma_rad: float) -> Between:
    """Count in the vertical the odometry felt at the instant, against what is open beside the keyframes."""
    felt, seen = pieces.T_odom_body[index, 2, :3], pose.T_world_body[2, :3]
    across = np.linalg.svd(felt[None])[2][1:]  # two directions in the body's level plane
    # turning the body by w moves the vertical it sees by -w x seen
    H = np.zeros((2, 6))
    H[:, :3] = across @ np.array([[0, -seen[2], seen[1]], [seen[2], 0, -seen[0]], [-seen[1], seen[0], 0]])
    variance = float(pieces.tilt_variance_rad2[index]) + gravity_sigma_rad**2
    gain = np.linalg.solve(H @ pose.own_covariance @ H.T + variance * np.eye(2), H @ pose.own_covariance).T
    keep = np.eye(6) - gain @ H
    own = keep @ pose.own_covariance @ keep.T + variance * gain @ gain.T
    T = pose.T_world_body @ se3.exp(gain @ (across @ (felt - seen)))
    return Between(pose.indices, T, keep @ pose.by_before, keep @ pose.by_after, own)
