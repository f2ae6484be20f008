"""A clock offset as the standard ROS message for two readings of one instant."""

import re
from typing import Any

from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.fleet.clock_offset import ClockOffset
from mulan.fleet.content_checks import to_ns
from mulan.mission.ros_stamps import to_stamp

_SOURCE = "base station, within {bound_s:.9f} s"
_BOUND = re.compile(r"within (\d{1,9}\.\d{9}) s")


def clock_record(robot: str, offset: ClockOffset, robot_ns: int) -> Any:
    """``sensor_msgs/TimeReference``: the robot's clock in the header, the base station's in ``time_ref``.

    Raises:
        ValueError: A clock stands before the epoch.
    """
    base_ns = robot_ns + offset.offset_ns
    if min(robot_ns, base_ns) < 0:
        raise ValueError("a clock stands before the epoch")
    header = ros.std_msgs__msg__Header(to_stamp(robot_ns), robot)
    source = _SOURCE.format(bound_s=offset.bound_ns * 1e-9)
    return ros.sensor_msgs__msg__TimeReference(header, to_stamp(base_ns), source)


def recorded_offset(message: Any) -> ClockOffset:
    """The offset in such a message; its bound is a day where the source does not tell it."""
    bound = _BOUND.search(message.source)
    bound_ns = 86_400_000_000_000 if bound is None else round(float(bound.group(1)) * 1e9)
    return ClockOffset(to_ns(message.time_ref) - to_ns(message.header.stamp), bound_ns)
