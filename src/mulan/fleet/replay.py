"""A robot that replays what one recorded, in real time or faster."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from rosbags.rosbag2 import Reader

from mulan.errors import InputError
from mulan.fleet.content_checks import to_ns
from mulan.fleet.image_budget import ImageBudget, ImageConfig
from mulan.fleet.odometry_thinning import OdometryConfig, OdometryThinning
from mulan.fleet.robot_link import RobotLink
from mulan.fleet.spool import Spool, Unsent
from mulan.fleet.wire_topics import MOUNTS, WIRE_TOPICS, Importance
from mulan.mission import bag_topics, messages, ros_poses
from mulan.mission.ros_stamps import NANOSECONDS

REPLAY_STARTED = "replay started"  # wall clock, noted in the spool


@dataclass(frozen=True)
class ReplayConfig:
    """What is replayed, how fast, and what of it is sent."""

    bag: Path | None = None
    """Mission bag to replay."""
    speed: float = 1.0
    """Times real time; 0 sends as fast as the link takes."""
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    """Dead reckoning sent."""
    images: ImageConfig = field(default_factory=ImageConfig)
    """Photographs sent."""


@dataclass(frozen=True)
class _Recorded:
    suffix: str
    log_ns: int
    record_ns: int
    payload: bytes
    message: Any


@runtime_checkable
class RecordingClock(Protocol):
    """The time recorded messages are stamped with."""

    def now_ns(self) -> int:
        """That time now."""
        ...

    def wait_until(self, log_ns: int, stop: Callable[[], bool]) -> None:
        """Sleep until that time has come to a message's."""
        ...


class ReplayClock:
    """The bag's time, kept going through restarts of the process by a note in the spool.

    Attributes:
        start_ns: First stamp of the bag.
    """

    def __init__(self, bag: Path, robot: str, speed: float, spool_path: Path, spool_mb: float) -> None:
        """Read the bag's extent and when the replay began.

        Raises:
            InputError: The bag cannot be read or lacks the robot, or the spool cannot be used.
        """
        bag_topics.check_file(bag)
        if speed < 0:
            raise InputError(
                "replay", "speed", "is negative", "give 1 for real time, 0 for as fast as it goes"
            )
        with Reader(bag) as reader:
            names = {connection.topic for connection in reader.connections}
            self.start_ns, end_ns = reader.start_time, reader.end_time
        if messages.ODOMETRY.of(robot) not in names:
            others = sorted(name.split("/")[1] for name in names if name.endswith("/odom"))
            remedy = f"choose from {', '.join(others)}" if others else "record its odometry"
            raise InputError(bag, f"robot '{robot}'", "has no odometry in the bag", remedy)
        self._speed, self._end_ns = speed, end_ns
        spool = Spool(spool_path, int(spool_mb * 1e6))
        started_ns = spool.noted(REPLAY_STARTED)
        if started_ns is None:
            started_ns = time.time_ns()
            spool.note(REPLAY_STARTED, started_ns)
        spool.close()
        self._started_ns = started_ns

    def now_ns(self) -> int:
        """The bag's time now."""
        if self._speed == 0:
            return self._end_ns + time.time_ns() - self._started_ns
        return self.start_ns + int((time.time_ns() - self._started_ns) * self._speed)

    def wait_until(self, log_ns: int, stop: Callable[[], bool]) -> None:
        """Sleep until the bag's time has come to a message's."""
        while self._speed and not stop():
            left_s = (log_ns - self.now_ns()) * 1e-9 / self._speed
            if left_s <= 0:
                return
            time.sleep(min(left_s, 0.2))


class Replay:
    """Feeds one robot's part of a bag to its link; begins where the last process stopped.

    Attributes:
        images: What became of the photographs.
        total, done: Messages of the robot in the bag, and how many were dealt with.
    """

    def __init__(self, config: ReplayConfig, link: RobotLink, clock: RecordingClock) -> None:
        self.images = ImageBudget(config.images)
        self.total = 0
        self.done = 0
        self._config, self._link, self._clock = config, link, clock
        self._thinning: OdometryThinning[bytes] = OdometryThinning(config.odometry)
        self._truth_thinning: OdometryThinning[bytes] = OdometryThinning(config.odometry)
        self._last_pose: Float[NDArray, "4 4"] | None = None

    def run(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Replay until the end of the bag, or until told to stop.

        Raises:
            OSError: The spool's disk is full.
            InputError: A photograph cannot be read.
        """
        resume_at = self._link.spool.position
        for bag in self._bags(stop):
            with Reader(bag) as reader:
                self.total += sum(c.msgcount for c in reader.connections if self._suffix(c.topic))
                for recorded in self._recorded(reader, bag):
                    self.done += 1
                    again = self.done <= resume_at
                    if not again:
                        self._clock.wait_until(recorded.log_ns, stop)
                    if stop():
                        return
                    self._feed(recorded, again)

    def _bags(self, stop: Callable[[], bool]) -> Iterator[Path]:  # noqa: ARG002
        """What is replayed, one after another."""
        if self._config.bag is None:
            raise InputError("replay", "bag", "is not named", "give --bag")
        yield self._config.bag

    def _feed(self, recorded: _Recorded, again: bool) -> None:
        """Send what is due by a message; ``again`` only brings the choosers to where they were."""
        chosen = self._chosen(recorded)
        if again:
            return
        if chosen:  # else the next one that is sent keeps the place
            self._link.send_all(chosen, self.done)

    def _chosen(self, recorded: _Recorded) -> list[Unsent]:
        suffix, record_ns, message = recorded.suffix, recorded.record_ns, recorded.message
        own = [Unsent(WIRE_TOPICS[suffix].importance, suffix, record_ns, recorded.payload)]
        if suffix == messages.ODOMETRY.suffix:
            self._last_pose = _pose(message)
            return _poses(suffix, self._thinning.odometry(record_ns, recorded.payload))
        if suffix == messages.GROUND_TRUTH.suffix:
            return _poses(suffix, self._truth_thinning.odometry(record_ns, recorded.payload))
        if suffix == messages.CSI.suffix:
            return _poses(messages.ODOMETRY.suffix, self._thinning.packet(record_ns)) + own
        if suffix == messages.IMAGE.suffix:
            fitted = self.images.fit(message.data.tobytes(), record_ns / NANOSECONDS, self._last_pose)
            if fitted is None:
                return []
            payload = recorded.payload if len(fitted) == len(message.data) else _image(message, fitted)
            poses = _poses(messages.ODOMETRY.suffix, self._thinning.photograph())
            truth = _poses(messages.GROUND_TRUTH.suffix, self._truth_thinning.photograph())
            return [*poses, *truth, Unsent(Importance.IMAGE, suffix, record_ns, payload)]
        return own

    def _suffix(self, topic: str) -> str | None:
        """The wire's name of one of this robot's topics in the bag; None for any other."""
        if topic == messages.TF_STATIC:
            return MOUNTS.suffix
        prefix = f"/{self._link.config.name}/"
        suffix = topic.removeprefix(prefix)
        known = topic.startswith(prefix) and suffix in WIRE_TOPICS
        return suffix if known and suffix != MOUNTS.suffix else None

    def _recorded(self, reader: Reader, bag: Path) -> Iterator[_Recorded]:
        """This robot's messages in the order they were logged, its mounts taken out of the common topic."""
        store = messages.typestore()
        wanted = [c for c in reader.connections if self._suffix(c.topic)]
        for connection, log_ns, data in reader.messages(wanted):
            suffix = self._suffix(connection.topic)
            assert suffix is not None
            entry = WIRE_TOPICS[suffix]
            if connection.msgtype != entry.topic.msgtype:
                problem = f"has type {connection.msgtype} instead of {entry.topic.msgtype}"
                raise InputError(bag, f"topic {connection.topic}", problem, "record that type")
            message: Any = store.deserialize_cdr(data, connection.msgtype)
            payload = bytes(data)
            if suffix == MOUNTS.suffix:
                prefix = f"{self._link.config.name}/"
                mine = [t for t in message.transforms if t.child_frame_id.startswith(prefix)]
                if not mine:
                    continue
                message = type(message)(mine)
                payload = bytes(store.serialize_cdr(message, MOUNTS.msgtype))
            stamped = entry.importance is not Importance.CALIBRATION
            record_ns = to_ns(message.header.stamp) if stamped else log_ns
            yield _Recorded(suffix, log_ns, record_ns, payload, message)


def _poses(suffix: str, found: list[tuple[int, bytes, Importance]]) -> list[Unsent]:
    truth = suffix == messages.GROUND_TRUTH.suffix
    return [Unsent(Importance.EVALUATION if truth else i, suffix, t, data) for t, data, i in found]


def _pose(message: Any) -> Float[NDArray, "4 4"]:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    return ros_poses.to_matrices(np.array([[p.x, p.y, p.z]]), np.array([[q.x, q.y, q.z, q.w]]))[0]


def _image(message: Any, data: bytes) -> bytes:
    made = type(message)(message.header, "jpeg", np.frombuffer(data, np.uint8))
    return bytes(messages.typestore().serialize_cdr(made, messages.IMAGE.msgtype))
