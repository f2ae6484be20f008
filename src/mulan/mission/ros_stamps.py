"""Seconds as float64 to ROS stamps and back, without losing a bit of what a stamp can hold."""

import math
from typing import Any

from rosbags.typesys.stores import ros2_jazzy as ros

Time = ros.builtin_interfaces__msg__Time
NANOSECONDS = 1_000_000_000


def to_nanoseconds(time_s: float) -> int:
    """Whole nanoseconds of a time in seconds, rounded to nearest.

    Raises:
        ValueError: The time is not finite, negative, or beyond the stamp's 31-bit seconds.
    """
    if not (math.isfinite(time_s) and 0 <= time_s < 2**31 - 1):
        raise ValueError(f"time {time_s} s does not fit a ROS stamp")
    seconds = math.floor(time_s)
    # the fraction is exact in float64; the product of the whole time would not be
    return seconds * NANOSECONDS + round((time_s - seconds) * NANOSECONDS)


def to_stamp(time_ns: int) -> Time:
    """ROS stamp of a time in nanoseconds."""
    return Time(*divmod(time_ns, NANOSECONDS))


def stamp_s(message: Any) -> float:
    """Time in seconds in a message's header."""
    stamp = message.header.stamp
    return float(stamp.sec) + stamp.nanosec / NANOSECONDS
