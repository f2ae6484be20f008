"""A robot that replays what one recorded, in real time or faster."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from rosbags.rosbag2 import Reader

from mulan.errors import InputError
from mulan.fleet.content_checks import to_ns
from mulan.fleet.message_choice import MessageChoice, own_mounts
from mulan.fleet.robot_link import RobotLink
from mulan.fleet.spool import Spool
from mulan.fleet.wire_topics import MOUNTS, WIRE_TOPICS, Importance
from mulan.mission import bag_topics, messages

REPLAY_STARTED = "replay started"  # wall clock, noted in the spool


@dataclass(frozen=True)
class ReplayConfig:
    """What is replayed, how fast, and what of it is sent."""

    bag: Path | None = None
    """Mission bag to replay."""
    speed: float = 1.0
    """Times real time; 0 sends as fast as the link takes."""


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
        choice: What of the messages is sent.
        total, done: Messages of the robot in the bag, and how many were dealt with.
    """

    def __init__(
        self, config: ReplayConfig, choice: MessageChoice, link: RobotLink, clock: RecordingClock
    ) -> None:
        self.choice = choice
        self.total = 0
        self.done = 0
        self._config, self._link, self._clock = config, link, clock

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
        chosen = self.choice.of(recorded.suffix, recorded.record_ns, recorded.message, recorded.payload)
        if again:
            return
        if chosen:  # else the next one that is sent keeps the place
            self._link.send_all(chosen, self.done)

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
                message = own_mounts(message, self._link.config.name)
                if message is None:
                    continue
                payload = bytes(store.serialize_cdr(message, MOUNTS.msgtype))
            stamped = entry.importance is not Importance.CALIBRATION
            record_ns = to_ns(message.header.stamp) if stamped else log_ns
            yield _Recorded(suffix, log_ns, record_ns, payload, message)
