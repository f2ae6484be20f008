"""What a robot may send: the bag's topics, each with its message type and its importance."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cache

from mulan.mission import messages
from mulan.mission.messages import Topic


class Importance(IntEnum):
    """Order in which a robot sends what waits; also how traffic is counted."""

    CALIBRATION = 0
    COORDINATION = 1  # odometry and ranges: what localization cannot do without
    RADIO = 2  # packets of an aperture
    EVALUATION = 3
    IMAGE = 4


@dataclass(frozen=True)
class WireTopic:
    """One kind of message.

    Attributes:
        topic: Suffix and message type.
        importance: How it is queued and counted.
        shared: Whether the bag has it without a robot's name in front.
    """

    topic: Topic
    importance: Importance
    shared: bool = False

    def bag_topic(self, robot: str) -> str:
        """Name of the topic in the bag."""
        return f"/{self.topic.suffix}" if self.shared else self.topic.of(robot)


CLOCK = Topic("clock", "sensor_msgs/msg/TimeReference")  # header: robot's clock; time_ref: the base's
MOUNTS = Topic(messages.TF_STATIC.removeprefix("/"), messages.TF_STATIC_TYPE)

WIRE_TOPICS = {
    entry.topic.suffix: entry
    for entry in (
        WireTopic(messages.CAMERA_INFO, Importance.CALIBRATION),
        WireTopic(MOUNTS, Importance.CALIBRATION, shared=True),
        WireTopic(messages.ODOMETRY, Importance.COORDINATION),
        WireTopic(messages.RANGE, Importance.COORDINATION),
        WireTopic(CLOCK, Importance.COORDINATION),
        WireTopic(messages.CSI, Importance.RADIO),
        WireTopic(messages.GROUND_TRUTH, Importance.EVALUATION),
        WireTopic(messages.IMAGE, Importance.IMAGE),
    )
}
# stamped when the robot was switched on, not when they are sent
CALIBRATION = tuple(t for t in WIRE_TOPICS.values() if t.importance is Importance.CALIBRATION)


@cache
def type_hash(msgtype: str) -> bytes:
    """First eight bytes of the ROS 2 type hash (RIHS01), which changes with name and definition."""
    return bytes.fromhex(messages.typestore().hash_rihs01(msgtype).removeprefix("RIHS01_"))[:8]
