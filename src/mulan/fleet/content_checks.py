"""Whether a message holds what the bag's reader will accept, so that no message can spoil a whole bag."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.fleet.names import is_robot_name
from mulan.fleet.refusals import Deferral, Refusal
from mulan.fleet.wire_topics import CLOCK, MOUNTS, WireTopic
from mulan.geometry.camera import PinholeCamera
from mulan.mission import bag_csi, bag_tracks, messages, pixels, ros_camera
from mulan.mission.bag_mounts import Mounts
from mulan.mission.bag_topics import BagTopics
from mulan.mission.messages import RobotFrames


class ContentChecks:
    """What one robot's earlier messages promised about its later ones.

    Attributes:
        robot: Its name.
        camera: Its first calibration.
        mounts: Parent of each of its frames.
        csi_layouts: Antennas and subcarrier frequencies of the packets from each peer.
    """

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self.camera: PinholeCamera | None = None
        self.mounts: dict[str, str] = {}
        self.csi_layouts: dict[str, tuple[int, bytes]] = {}

    def check(self, topic: WireTopic, message: Any, robots: Collection[str]) -> Refusal | Deferral | None:
        """What is wrong with a decoded message, by the very checks of the bag's reader.

        Args:
            topic: Where it came.
            message: The decoded message.
            robots: Names a peer may have; any valid one if empty.
        """
        try:
            return self._check(topic, message, robots)
        except (InputError, ValueError, TypeError, IndexError, AttributeError, OverflowError):
            return Refusal.MALFORMED

    def remember(self, topic: WireTopic, message: Any) -> None:
        """Take note of a message that has passed the checks."""
        if topic.topic == messages.CAMERA_INFO and self.camera is None:
            self.camera = ros_camera.from_camera_info(message)
        elif topic.topic == MOUNTS:
            bag = BagTopics(Path(), {messages.TF_STATIC: [message]})
            self.mounts |= {child: parent for child, (parent, _) in Mounts.of(bag).parent.items()}
        elif topic.topic == messages.CSI:
            self.csi_layouts.setdefault(message.peer, _layout(message))

    def _check(self, topic: WireTopic, message: Any, robots: Collection[str]) -> Refusal | Deferral | None:
        kind, robot = topic.topic, self.robot
        bag = BagTopics(Path(f"message from {robot}"), {topic.bag_topic(robot): [message]})
        if kind in (messages.CSI, messages.RANGE) and not self._may_be_peer(message.peer, robots):
            return Refusal.MALFORMED
        if kind == messages.CAMERA_INFO:
            camera = bag_tracks.camera(bag, robot)
            if self.camera is not None and camera != self.camera:
                return Refusal.MALFORMED
        elif kind == MOUNTS:
            return self._check_mounts(Mounts.of(bag))
        elif kind == messages.ODOMETRY:
            bag_tracks.odometry(bag, robot)
        elif kind == messages.RANGE:
            bag_tracks.ranges(bag, robot)
        elif kind == messages.CSI:
            bag_csi.csi(bag, robot)
            if self.csi_layouts.get(message.peer, _layout(message)) != _layout(message):
                return Refusal.MALFORMED
        elif kind == messages.GROUND_TRUTH:
            bag_tracks.poses(bag, robot)
        elif kind == messages.IMAGE:
            if self.camera is None:
                return Deferral.CAMERA_UNKNOWN
            for photo in bag_tracks.photos(bag, robot, self.camera):
                pixels.decode(photo.data, bag.source.name)
        elif kind == CLOCK:
            to_ns(message.time_ref)
        return None

    def _check_mounts(self, published: Mounts) -> Refusal | None:
        """A frame keeps its parent, and every frame leads to the robot's own body."""
        body = RobotFrames(self.robot).body
        parents = {child: parent for child, (parent, _) in published.parent.items()}
        if any(self.mounts.get(child, parent) != parent for child, parent in parents.items()):
            return Refusal.MALFORMED
        merged = self.mounts | parents
        for frame in parents:
            at = frame
            for _ in merged:
                at = merged.get(at, at) if at != body else body
            if at != body or frame == body or not frame.startswith(f"{self.robot}/"):
                return Refusal.MALFORMED
        return None

    def _may_be_peer(self, name: str, robots: Collection[str]) -> bool:
        return name != self.robot and (name in robots if robots else is_robot_name(name))


def _layout(message: Any) -> tuple[int, bytes]:
    return int(message.antennas), message.subcarrier_hz.tobytes()


def to_ns(stamp: Any) -> int:
    """A ROS stamp in nanoseconds.

    Raises:
        ValueError: It is negative, or its fraction is a second or more.
    """
    if stamp.sec < 0 or not 0 <= stamp.nanosec < 1_000_000_000:
        raise ValueError("the stamp is not a time")
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
