"""Tying a measurement to the keyframes that have arrived."""

from collections.abc import Mapping

from mulan.geometry import se3
from mulan.localization.factors import Sight
from mulan.localization.graph import BearingNode, RangeNode
from mulan.localization.online_robot import OnlineRobot
from mulan.localization.relative_measurements import bearing_origin
from mulan.wireless.types import Bearing, Range


def keyframes_of(
    measurement: Bearing | Range,
    peer_time_s: float,
    robots: Mapping[str, OnlineRobot],
    merge_s: float,
    longest_gap_s: float,
) -> tuple[int, int] | None:
    """Keyframes of observer and peer a measurement hangs on; None while one is still to come.

    Raises:
        LookupError: A robot was silent then, so it can hang nowhere.
    """
    observer, peer = robots[measurement.observer], robots[measurement.peer]
    i = observer.nearest(measurement.time_s, merge_s, longest_gap_s)
    j = peer.nearest(peer_time_s, merge_s, longest_gap_s)
    if i is None or j is None:
        return None
    if i < 0 or j < 0:
        raise LookupError("the measurement fell into a gap of a robot's keyframes")
    return i, j


def hang_bearing(
    bearing: Bearing, observer: OnlineRobot, peer: OnlineRobot, at: tuple[int, int]
) -> BearingNode:
    """The bearing's node, its points carried to the keyframes by odometry."""
    i, j = at
    target = se3.transform(peer.pose_odom(bearing.peer_time_s), peer.log.wifi_antenna_body_m)
    sight = Sight(
        observer.key(i),
        peer.key(j),
        observer.point_in_keyframe(i, bearing_origin(bearing, observer.log)),
        peer.point_in_keyframe(j, target),
    )
    return BearingNode(bearing, sight, observer.T_odom_body[i][:3, :3].T)


def hang_range(
    measurement: Range,
    peer_time_s: float,
    observer: OnlineRobot,
    peer: OnlineRobot,
    at: tuple[int, int],
    bias_key: int,
) -> RangeNode:
    """The range's node, its points carried to the keyframes by odometry."""
    i, j = at
    origin = se3.transform(observer.pose_odom(measurement.time_s), observer.log.uwb_antenna_body_m)
    target = se3.transform(peer.pose_odom(peer_time_s), peer.log.uwb_antenna_body_m)
    sight = Sight(
        observer.key(i), peer.key(j), observer.point_in_keyframe(i, origin), peer.point_in_keyframe(j, target)
    )
    return RangeNode(measurement, sight, bias_key)
