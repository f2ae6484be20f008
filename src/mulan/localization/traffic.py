"""What two robots send each other to be localized, in bytes as ROS 2 encodes them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from mulan.mission import messages, robot_messages, ros_poses
from mulan.mission.messages import RobotFrames
from mulan.mission.ros_stamps import NANOSECONDS, to_nanoseconds, to_stamp
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing

BEARING_TYPE = "mulan_msgs/msg/Bearing"
BEARING_DEFINITION = """\
# Direction from an observer's antenna to a peer's, as a small mixture.
std_msgs/Header header                   # reference instant on the observer's clock; frame: its start frame
string peer                              # name of the other robot
builtin_interfaces/Time peer_stamp       # the same packets on the peer's clock
geometry_msgs/Pose body                  # the observer's body at the reference instant
geometry_msgs/Point origin               # where the directions start
float64[] direction                      # unit vectors, three numbers a hypothesis
float64[] covariance                     # 2x2 over (azimuth, elevation) tangents, row-major [rad^2]
float64[] weight
float64 outlier_mass
float64 kappa_paper
uint32 packets
"""


def _typestore() -> Typestore:
    store = messages.typestore()
    if BEARING_TYPE not in store.fielddefs:
        store.register(get_types_from_msg(BEARING_DEFINITION, BEARING_TYPE))
    return store


def encode_bearing(bearing: Bearing) -> bytes:
    """A bearing as CDR; its profile is not sent."""
    store = _typestore()
    types = store.types
    Point, Header = types["geometry_msgs/msg/Point"], types["std_msgs/msg/Header"]
    origin = bearing.T_odom_body[:3, 3] if bearing.origin_odom_m is None else bearing.origin_odom_m
    frame = RobotFrames(bearing.observer).odom
    make: Any = types[BEARING_TYPE]
    message = make(
        Header(to_stamp(to_nanoseconds(bearing.time_s)), frame),
        bearing.peer,
        to_stamp(to_nanoseconds(bearing.peer_time_s)),
        ros_poses.to_pose(bearing.T_odom_body),
        Point(*(float(c) for c in origin)),
        bearing.direction_odom.astype(np.float64).ravel(),
        bearing.tangent_covariance.astype(np.float64).ravel(),
        bearing.weight.astype(np.float64),
        float(bearing.outlier_mass),
        float(bearing.kappa_paper),
        int(bearing.packets),
    )
    return bytes(store.serialize_cdr(message, BEARING_TYPE))


def decode_bearing(data: bytes) -> Bearing:
    """The bearing in a message of ``encode_bearing``."""
    message: Any = _typestore().deserialize_cdr(data, BEARING_TYPE)
    position, q = message.body.position, message.body.orientation
    T = ros_poses.to_matrices(
        np.array([[position.x, position.y, position.z]]), np.array([[q.x, q.y, q.z, q.w]])
    )[0]
    return Bearing(
        observer=message.header.frame_id.split("/")[0],
        peer=message.peer,
        time_s=message.header.stamp.sec + message.header.stamp.nanosec / NANOSECONDS,
        peer_time_s=message.peer_stamp.sec + message.peer_stamp.nanosec / NANOSECONDS,
        T_odom_body=T,
        direction_odom=np.array(message.direction).reshape(-1, 3),
        tangent_covariance=np.array(message.covariance).reshape(-1, 2, 2),
        weight=np.array(message.weight),
        outlier_mass=message.outlier_mass,
        kappa_paper=message.kappa_paper,
        packets=message.packets,
        origin_odom_m=np.array([message.origin.x, message.origin.y, message.origin.z]),
    )


@dataclass(frozen=True)
class PairTraffic:
    """Bytes two robots exchanged.

    Attributes:
        odometry_bytes: Keyframes of both (nav_msgs/Odometry).
        range_bytes: Ranges between them, in both directions.
        bearing_bytes: Bearings between them, in both directions.
        duration_s: Of the mission.
    """

    odometry_bytes: int
    range_bytes: int
    bearing_bytes: int
    duration_s: float

    @property
    def bytes_per_s(self) -> float:
        """All of it, a second."""
        return (self.odometry_bytes + self.range_bytes + self.bearing_bytes) / self.duration_s


def pair_traffic(
    robots: Sequence[RobotLog], bearings: Sequence[Bearing], keyframe_s: float = 1.0
) -> Mapping[tuple[str, str], PairTraffic]:
    """Coordination traffic of every pair, from messages really encoded.

    Counted are keyframes, ranges and bearings. The radio packets an aperture is made of are the measurement
    itself and not counted; nor are photographs. A keyframe one robot sends to all is counted for every pair.

    Args:
        robots: What they recorded.
        bearings: Between them.
        keyframe_s: Odometry is sent so often, whatever its own rate.
    """
    store = _typestore()
    odometry: dict[str, int] = {}
    ranges: dict[tuple[str, str], int] = {}
    span: dict[str, tuple[float, float]] = {}
    for robot in robots:
        stamped = robot_messages.of_robot(robot)
        time_s = robot.odometry.time_s
        span[robot.name] = float(time_s[0]), float(time_s[-1])
        due = np.searchsorted(time_s, np.arange(time_s[0], time_s[-1] + 1e-9, keyframe_s) - 1e-9)
        sent = [stamped[messages.ODOMETRY][i][1] for i in np.unique(due)]
        odometry[robot.name] = sum(len(store.serialize_cdr(m, messages.ODOMETRY.msgtype)) for m in sent)
        for _, message in stamped.get(messages.RANGE, []):
            pair = _pair(robot.name, message.peer)
            size = len(store.serialize_cdr(message, messages.RANGE_TYPE))
            ranges[pair] = ranges.get(pair, 0) + size
    of_bearings: dict[tuple[str, str], int] = {}
    for bearing in bearings:
        pair = _pair(bearing.observer, bearing.peer)
        of_bearings[pair] = of_bearings.get(pair, 0) + len(encode_bearing(bearing))
    names = sorted(odometry)
    return {
        (a, b): PairTraffic(
            odometry[a] + odometry[b],
            ranges.get((a, b), 0),
            of_bearings.get((a, b), 0),
            max(span[a][1], span[b][1]) - min(span[a][0], span[b][0]),
        )
        for i, a in enumerate(names)
        for b in names[i + 1 :]
    }


def _pair(first: str, second: str) -> tuple[str, str]:
    return (first, second) if first < second else (second, first)
