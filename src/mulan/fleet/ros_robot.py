"""A robot that runs ROS 2: its topics come and goals go through a zenoh-bridge-ros2dds on the robot.

The bridge has the topic ``/alpha/odom``, or ``/odom`` if its own ``namespace`` is ``/alpha``, under the Zenoh
key ``alpha/odom``, with the bytes DDS carries: the same CDR as in a bag. It forwards a topic once someone has
subscribed to its key. What was published before, on topics that keep their last messages (``/tf_static``),
it keeps under keys of its own and gives to who asks.
"""

import queue
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import zenoh

from mulan.errors import InputError
from mulan.fleet.content_checks import to_ns
from mulan.fleet.message_choice import MessageChoice, own_mounts
from mulan.fleet.robot_link import RobotLink
from mulan.fleet.wire_topics import MOUNTS, WIRE_TOPICS, Importance
from mulan.fleet.zenoh_session import open_bridge_session
from mulan.mission import messages
from mulan.mission.messages import Topic
from mulan.mission.ros_stamps import to_stamp

ORDERS = (messages.GOAL, messages.POSE, messages.REQUEST)
_MOST_WAITING = 20_000  # messages, if the robot's disk is slower than its sensors
_ASK_AGAIN_S = 5.0
_SILENT_S = 15.0


@dataclass(frozen=True)
class RosConfig:
    """A robot's ROS 2 topics behind a zenoh-bridge-ros2dds."""

    endpoint: str = ""
    """Where the bridge listens, such as tcp/127.0.0.1:7447."""
    topics: dict[str, str] = field(default_factory=dict)
    """Topics with other names: ours without the robot's name, then theirs, such as odom /vio/odometry."""

    def key(self, robot: str, suffix: str) -> str:
        """Zenoh key of a topic."""
        return self.topics.get(suffix, f"{robot}/{suffix}").strip("/")


class RosRobot:
    """Passes a robot's topics to its link, and what the base station orders to its topics.

    A calibration, which ROS 2 repeats with every photograph, is sent when it changes.

    Attributes:
        choice: What of the messages is sent.
        done, total: Messages that came.
        unreadable: Messages that were not of their topic's type.
    """

    def __init__(
        self,
        config: RosConfig,
        choice: MessageChoice,
        tell: Callable[[str], object] = lambda _: None,
    ) -> None:
        """Open the session; nothing is listened to before :meth:`run`.

        Raises:
            InputError: The endpoint is not one, or a topic named is none a robot sends.
        """
        for suffix in config.topics:
            if suffix not in WIRE_TOPICS:
                remedy = f"choose from {', '.join(WIRE_TOPICS)}"
                raise InputError("options", f"--ros.topics '{suffix}'", "is no topic of a mission", remedy)
        self.choice = choice
        self.done = self.unreadable = 0
        self._config, self._tell = config, tell
        self._waiting: queue.Queue[tuple[str, bytes]] = queue.Queue(_MOST_WAITING)
        self._calibration: dict[str, bytes] = {}
        self._heard: set[str] = set()
        self._ordered: dict[Topic, tuple[int, int]] = {}
        self._session = open_bridge_session(config.endpoint)

    @property
    def total(self) -> int:
        """Messages that came."""
        return self.done

    def orders(self, robot: str) -> Mapping[Topic, Callable[[Any], object]]:
        """What :class:`RobotLink` is to call with what the base station orders."""
        return {topic: lambda message, topic=topic: self._order(robot, topic, message) for topic in ORDERS}

    def run(self, link: RobotLink, stop: Callable[[], bool] = lambda: False) -> None:
        """Listen until told to stop.

        Raises:
            OSError: The spool's disk is full.
            InputError: A photograph cannot be read.
        """
        robot = link.config.name
        subscribers = [
            self._session.declare_subscriber(
                self._config.key(robot, suffix), lambda s, suffix=suffix: self._hear(suffix, s.payload)
            )
            for suffix in WIRE_TOPICS
            if suffix != "clock"  # the link makes it itself
        ]
        # without a namespace the bridge has the common topic under its plain name
        shared = self._session.declare_subscriber(
            MOUNTS.suffix, lambda s: self._hear(MOUNTS.suffix, s.payload)
        )
        began_s, asked_s, told = time.monotonic(), float("-inf"), False
        try:
            while not stop():
                now_s = time.monotonic()
                if MOUNTS.suffix not in self._heard and now_s - asked_s > _ASK_AGAIN_S:
                    asked_s = now_s
                    self._ask_for_mounts(robot)
                if not told and now_s - began_s > _SILENT_S:
                    told = True
                    self._tell_what_is_silent(robot)
                try:
                    suffix, payload = self._waiting.get(timeout=0.1)
                except queue.Empty:
                    continue
                self._heard.add(suffix)
                self._take(link, suffix, payload)
        finally:
            for subscriber in (*subscribers, shared):
                subscriber.undeclare()
            self._session.close()

    def _take(self, link: RobotLink, suffix: str, payload: bytes) -> None:
        topic, store = WIRE_TOPICS[suffix], messages.typestore()
        self.done += 1
        try:
            message: Any = store.deserialize_cdr(payload, topic.topic.msgtype)
            is_calibration = topic.importance is Importance.CALIBRATION
            record_ns = 0 if is_calibration else to_ns(message.header.stamp)
        except Exception:  # generated code: other bytes surface as whatever a field's reader raises
            if not self.unreadable:
                self._tell(f"{self._config.key(link.config.name, suffix)}: is no {topic.topic.msgtype}")
            self.unreadable += 1
            return
        if is_calibration:
            self._calibrate(link, topic.topic, message)
            return
        chosen = self.choice.of(suffix, record_ns, message, payload)
        if chosen:
            link.send_all(chosen)

    def _calibrate(self, link: RobotLink, topic: Topic, message: Any) -> None:
        if topic == MOUNTS:
            message = own_mounts(message, link.config.name)
            if message is None:
                return
        timeless = _without_stamps(message, topic)
        if self._calibration.get(topic.suffix) != timeless:
            self._calibration[topic.suffix] = timeless
            link.send(topic.suffix, message)

    def _hear(self, suffix: str, payload: zenoh.ZBytes) -> None:
        try:
            self._waiting.put_nowait((suffix, payload.to_bytes()))
        except queue.Full:
            return  # as DDS itself does

    def _ask_for_mounts(self, robot: str) -> None:
        """Of every bridge, by the names its versions keep them under."""
        for key in (self._config.key(robot, MOUNTS.suffix), MOUNTS.suffix):
            for kept in (f"@ros2_pub_cache/*/{key}", f"@/*/@ros2_pub_cache/{key}"):
                self._session.get(
                    kept,
                    lambda reply: reply.ok and self._hear(MOUNTS.suffix, reply.ok.payload),
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    accept_replies=zenoh.ReplyKeyExpr.ANY,
                    timeout=2.0,
                )

    def _tell_what_is_silent(self, robot: str) -> None:
        for topic in (messages.ODOMETRY, messages.IMAGE, messages.CAMERA_INFO, messages.CSI, MOUNTS):
            if topic.suffix not in self._heard:
                key = self._config.key(robot, topic.suffix)
                self._tell(
                    f"nothing has come under {key}: is /{key} published, and does the bridge allow it?"
                )

    def _order(self, robot: str, topic: Topic, message: Any) -> None:
        """A ROS 2 node would begin anew with every repetition, so each goes on once."""
        stamp = int(message.header.stamp.sec), int(message.header.stamp.nanosec)
        if self._ordered.get(topic) == stamp:
            return
        self._ordered[topic] = stamp
        if topic == messages.GOAL:
            # the stamp is the base station's clock; zero asks tf for the newest transform
            message = replace(message, header=replace(message.header, stamp=to_stamp(0)))
        payload = bytes(messages.typestore().serialize_cdr(message, topic.msgtype))
        self._session.put(self._config.key(robot, topic.suffix), payload)


def _without_stamps(message: Any, topic: Topic) -> bytes:
    if topic == MOUNTS:
        transforms = [replace(t, header=replace(t.header, stamp=to_stamp(0))) for t in message.transforms]
        message = replace(message, transforms=transforms)
    else:
        message = replace(message, header=replace(message.header, stamp=to_stamp(0)))
    return bytes(messages.typestore().serialize_cdr(message, topic.msgtype))
