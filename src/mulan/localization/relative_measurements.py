"""Bearings and ranges between one unplaced robot and those already placed, as plain arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.factors import level_direction
from mulan.localization.keyframes import clock_offset_s
from mulan.mission.types import RobotLog
from mulan.wireless.directions import tangent_basis
from mulan.wireless.types import Bearing, Range


@dataclass(frozen=True)
class SightLines:
    """Directions and the point they should meet; directions and origins in one frame, targets in the other.

    Attributes:
        origin_m, target_m: Points.
        direction: Unit vectors from the origins.
        whitener: Rows that turn a tangential miss into standard deviations; zero rows where unobserved.
    """

    origin_m: Float[NDArray, "m 3"]
    direction: Float[NDArray, "m 3"]
    whitener: Float[NDArray, "m 2 3"]
    target_m: Float[NDArray, "m 3"]


@dataclass(frozen=True)
class RelativeMeasurements:
    """All that ties one robot's start frame to the world.

    Attributes:
        seen: Placed robots look at this one: origins in the world, targets in the robot's odometry frame.
        sees: This one looks at placed robots: origins in its odometry frame, targets in the world.
        antenna_odom_m, antenna_world_m, range_m, range_sigma_m: Ranges between the two points.
        floor_odom_m, floor_world_m, floor_sigma_m: Body heights that should agree, where a floor is shared.
    """

    seen: SightLines
    sees: SightLines
    antenna_odom_m: Float[NDArray, "r 3"]
    antenna_world_m: Float[NDArray, "r 3"]
    range_m: Float[NDArray, "r"]
    range_sigma_m: Float[NDArray, "r"]
    floor_odom_m: float = 0.0
    floor_world_m: float = 0.0
    floor_sigma_m: float | None = None

    @property
    def count(self) -> int:
        """Bearings and ranges together."""
        return len(self.seen.origin_m) + len(self.sees.origin_m) + len(self.range_m)


def points_at(
    robot: RobotLog, time_s: Float[NDArray, "q"], lever_body_m: Float[NDArray, "3"]
) -> Float[NDArray, "q 3"]:
    """A body point in the odometry frame at times."""
    T = se3.interpolate(robot.odometry.time_s, robot.odometry.T_odom_body, time_s)
    return T[:, :3, :3] @ lever_body_m + T[:, :3, 3]


def point_at(robot: RobotLog, time_s: float, lever_body_m: Float[NDArray, "3"]) -> Float[NDArray, "3"]:
    """A body point in the odometry frame at one time."""
    return points_at(robot, np.array([time_s]), lever_body_m)[0]


def range_endpoints(
    logs: Mapping[str, RobotLog], ranges: Sequence[Range], bearings: Sequence[Bearing]
) -> tuple[Float[NDArray, "r"], Float[NDArray, "r 3"], Float[NDArray, "r 3"]]:
    """Peer clock times, and the UWB antennas of observer and peer in their own odometry frames."""
    offset = {pair: clock_offset_s(*pair, bearings) for pair in {(r.observer, r.peer) for r in ranges}}
    time_s = np.array([r.time_s for r in ranges], dtype=float)
    peer_s = time_s + np.array([offset[r.observer, r.peer] for r in ranges], dtype=float)
    observer_odom_m, peer_odom_m = np.zeros((len(ranges), 3)), np.zeros((len(ranges), 3))
    observer = np.array([r.observer for r in ranges], dtype=str)
    peer = np.array([r.peer for r in ranges], dtype=str)
    for name in np.unique([observer, peer]).tolist():
        log, observing, answering = logs[name], observer == name, peer == name
        observer_odom_m[observing] = points_at(log, time_s[observing], log.uwb_antenna_body_m)
        peer_odom_m[answering] = points_at(log, peer_s[answering], log.uwb_antenna_body_m)
    return peer_s, observer_odom_m, peer_odom_m


def bearing_targets(logs: Mapping[str, RobotLog], bearings: Sequence[Bearing]) -> Float[NDArray, "m 3"]:
    """The peer's WiFi antenna of every bearing, in the peer's odometry frame."""
    target_odom_m = np.zeros((len(bearings), 3))
    peer = np.array([b.peer for b in bearings], dtype=str)
    time_s = np.array([b.peer_time_s for b in bearings], dtype=float)
    for name in np.unique(peer):
        of = peer == name
        log = logs[str(name)]
        target_odom_m[of] = points_at(log, time_s[of], log.wifi_antenna_body_m)
    return target_odom_m


def bearing_origin(bearing: Bearing, observer: RobotLog) -> Float[NDArray, "3"]:
    """Where a bearing starts, in the observer's odometry frame."""
    if bearing.origin_odom_m is not None:
        return bearing.origin_odom_m
    return se3.transform(bearing.T_odom_body, observer.wifi_antenna_body_m)


def _whitener(
    bearing: Bearing, smallest_sigma_rad: float
) -> tuple[Float[NDArray, "3"], Float[NDArray, "2 3"]]:
    u, variance = bearing.direction_odom[0], np.diag(bearing.tangent_covariance[0])
    if not np.isfinite(variance[1]):
        u = level_direction(u)
    # 1/inf is the zero row of an unobserved axis
    return u, tangent_basis(u).T / np.sqrt(variance + smallest_sigma_rad**2)[:, None]


def _stack(rows: list[tuple[NDArray, NDArray, NDArray, NDArray]]) -> SightLines:
    if not rows:
        return SightLines(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros((0, 3)))
    origin, direction, whitener, target = (np.array(column) for column in zip(*rows, strict=True))
    return SightLines(origin, direction, whitener, target)


def gather(
    robot: RobotLog,
    placed: Mapping[str, tuple[RobotLog, Float[NDArray, "4 4"]]],
    bearings: Sequence[Bearing],
    ranges: Sequence[Range],
    smallest_sigma_rad: float,
    smallest_sigma_m: float,
    most_ranges: int,
) -> RelativeMeasurements:
    """Measurements between a robot and the placed ones (name: log, T_world_odom).

    Sigmas get a floor for the odometry drift that the start-frame alignment ignores.
    """
    seen, sees = [], []
    bearings = [
        b for b in bearings
        if (b.peer == robot.name and b.observer in placed) or (b.observer == robot.name and b.peer in placed)
    ]  # fmt: skip
    logs = {robot.name: robot, **{name: log for name, (log, _) in placed.items()}}
    targets = bearing_targets(logs, bearings)
    for bearing, target in zip(bearings, targets, strict=True):
        u, whitener = _whitener(bearing, smallest_sigma_rad)
        if bearing.peer == robot.name:
            log, T = placed[bearing.observer]
            R = T[:3, :3]
            origin = se3.transform(T, bearing_origin(bearing, log))
            seen.append((origin, R @ u, whitener @ R.T, target))
        else:
            in_world = se3.transform(placed[bearing.peer][1], target)
            sees.append((bearing_origin(bearing, robot), u, whitener, in_world))
    near = [r for r in ranges if r.observer == robot.name and r.peer in placed]
    near += [r for r in ranges if r.peer == robot.name and r.observer in placed]
    near = near[:: max(1, -(-len(near) // most_ranges))]
    _, of_observer, of_peer = range_endpoints(logs, near, bearings)
    observing = np.array([r.observer == robot.name for r in near], dtype=bool)[:, None]
    own, other = np.where(observing, of_observer, of_peer), np.where(observing, of_peer, of_observer)
    for i, r in enumerate(near):
        other[i] = se3.transform(placed[r.peer if r.observer == robot.name else r.observer][1], other[i])
    sigma = np.array([max(r.sigma_m, smallest_sigma_m) for r in near], dtype=float)
    range_m = np.array([r.range_m for r in near], dtype=float)
    return RelativeMeasurements(_stack(seen), _stack(sees), own, other, range_m, sigma)
