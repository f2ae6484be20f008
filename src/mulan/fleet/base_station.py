"""The base station: receives what robots send, writes it to the bag, and only then acknowledges."""

import queue
import secrets
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.fleet.acknowledgement import NOT_TIMED_NS, Acknowledgement, worth_telling
from mulan.fleet.clock_offset import ClockOffset
from mulan.fleet.clock_record import recorded_offset
from mulan.fleet.envelope import Envelope
from mulan.fleet.inbox import Inbox, Received
from mulan.fleet.ingest import Ingest, IngestConfig
from mulan.fleet.journal import Entry, Journal
from mulan.fleet.names import acknowledgement_key, check_mission_name, check_robot_name, order_key
from mulan.fleet.refusals import Deferral, LinkStatus, Refusal
from mulan.fleet.verdict import Arrival, Verdict
from mulan.fleet.wire_topics import CLOCK
from mulan.fleet.zenoh_session import LinkConfig, open_base_session
from mulan.mission import messages
from mulan.mission.messages import Topic

_LARGEST_BATCH = 128  # so that answers do not wait for long batches
_ANSWER_EVERY_S = 0.2
_ANSWER_AGAIN_S = 0.5  # an answer may be lost, so it is said again, ...
_ANSWER_FOR_S = 30.0  # ... until the robot's messages show that it came, or this long after its last one
_TICK_S = 0.05
_REFUSE_EVERY_S = 0.5
_REPEAT_EVERY_S = 1.0  # orders are not acknowledged, so the last one of each kind is said again


@dataclass(frozen=True)
class BaseConfig:
    """What a base station receives and where it writes."""

    out: Path
    """Bag to write, ending in .mcap; an unfinished one is gone on with."""
    mission: str = "mission"
    """Name of the mission, the same on every robot."""
    durable: bool = True
    """Wait for the disk before acknowledging, so that a power cut loses nothing; without it a crash of the
    program loses nothing, a power cut may."""
    inbox_mb: float = 64.0
    """Messages that wait for the disk; beyond this they are left to be sent again."""
    link: LinkConfig = field(default_factory=LinkConfig)
    """Network."""
    ingest: IngestConfig = field(default_factory=IngestConfig)
    """Limits on what robots may send."""


@dataclass
class _Heard:
    """The last message of a robot that is to be answered.

    Attributes:
        envelope: Of the message.
        received_ns: When it came, on this clock.
        heard_s, answered_s: When it came and when it was last answered, on the monotonic clock.
    """

    envelope: Envelope
    received_ns: int
    heard_s: float
    answered_s: float = 0.0


class BaseStation:
    """Receives, checks, writes, acknowledges; one thread does all of it after the network's.

    A message is given to ``on_message`` only when it is in the bag.

    Attributes:
        config: Options.
        ingest: Judges messages.
        journal: The bag.
        disk_problem: Why the disk takes no more, or an empty text.
        answered_bytes: Acknowledgements sent, by robot.
        clocks: Last offset each robot recorded.
    """

    def __init__(
        self,
        config: BaseConfig,
        on_message: Callable[[Verdict], object] = lambda _: None,
        tell: Callable[[str], object] = lambda _: None,
    ) -> None:
        """Open the bag and the network; receiving begins at once.

        Args:
            config: Options.
            on_message: Called with every message that was written, in the order of writing.
            tell: Called with a sentence when something happens that a person should know.

        Raises:
            InputError: A name is not valid, the bag cannot be written, or the network cannot be opened.
        """
        check_mission_name(config.mission, "base station")
        for name in config.ingest.robots:
            check_robot_name(name, "base station")
        self.config = config
        self.ingest = Ingest(config.mission, config.ingest)
        self.disk_problem = ""
        self.answered_bytes: dict[str, int] = {}
        self.clocks: dict[str, ClockOffset] = {}
        self._on_message, self._tell = on_message, tell
        self._id = secrets.randbits(63)
        self._inbox = Inbox(int(config.inbox_mb * 1e6), config.ingest.largest_message_bytes)
        self._due: set[str] = set()
        self._heard: dict[str, _Heard] = {}
        self._told: dict[tuple[str, str], float] = {}
        self._orders: queue.SimpleQueue[tuple[str, Topic, bytes]] = queue.SimpleQueue()
        self._ordered: dict[tuple[str, str], bytes] = {}
        self._orders_written = 0
        self._closing = threading.Event()
        self.journal = Journal(config.out, config.durable, self.ingest.remember)
        try:
            if self.journal.messages == 0:
                self._write_robots()
            self._session = open_base_session(config.link, config.mission, config.ingest.robots)
            self._subscriber = self._session.declare_subscriber(
                f"mulan/{config.mission}/**",
                self._inbox.receive,
                allowed_origin=zenoh.Locality.REMOTE,
            )
        except BaseException:
            self.journal.abandon()
            raise
        self._thread = threading.Thread(target=self._work, name="base station", daemon=True)
        self._thread.start()

    @property
    def inbox_dropped(self) -> int:
        """Messages left to be sent again because too many waited."""
        return self._inbox.dropped

    def order(self, robot: str, topic: Topic, message: Any) -> None:
        """Write a message of the base station's own to the bag and tell the robot; any thread may.

        A robot hears the last message of a topic again every second, until another takes its place.

        Args:
            robot: Who is told.
            topic: Where it stands in the bag, below the robot's name.
            message: A ROS message of the topic's type.
        """
        payload = bytes(messages.typestore().serialize_cdr(message, topic.msgtype))
        self._orders.put((robot, topic, payload))

    def close(self) -> None:
        """Stop receiving, write what waits, finish the bag."""
        self._subscriber.undeclare()
        self._closing.set()
        self._thread.join()
        self._session.close()
        try:
            self.journal.close()
        except OSError as error:
            self._tell(f"the bag could not be finished ({error.strerror}); opening it again goes on")

    def _write_robots(self) -> None:
        if not self.config.ingest.robots:
            return
        names = ros.std_msgs__msg__String(" ".join(self.config.ingest.robots))
        payload = bytes(messages.typestore().serialize_cdr(names, messages.ROBOTS_TYPE))
        now_ns = time.time_ns()
        self.journal.append([Entry(messages.ROBOTS, messages.ROBOTS_TYPE, "", 0, 0, now_ns, now_ns, payload)])

    def _work(self) -> None:
        answered_s = repeated_s = 0.0
        while True:
            batch = self._inbox.take(_LARGEST_BATCH, _TICK_S)
            if batch:
                self._take_in(batch)
            now_s = time.monotonic()
            again = self._unheard(now_s) - self._due
            if again:
                self._answer(again, timed=False)
            if self._due and (now_s - answered_s >= _ANSWER_EVERY_S or self._closing.is_set()):
                self._answer(self._due, timed=True)
                self._due.clear()
                answered_s = now_s
            self._pass_on_orders()
            if now_s - repeated_s >= _REPEAT_EVERY_S:
                for (robot, suffix), payload in self._ordered.items():
                    self._tell_robot(robot, suffix, payload)
                repeated_s = now_s
            if self._closing.is_set() and not batch:
                return

    def _pass_on_orders(self) -> None:
        """Orders go to the bag before they go out; with a full disk they wait."""
        while not self.disk_problem:
            try:
                robot, topic, payload = self._orders.get_nowait()
            except queue.Empty:
                return
            now_ns = time.time_ns()
            self._orders_written += 1
            entry = Entry(
                topic.of(robot), topic.msgtype, "", 0, self._orders_written, now_ns, now_ns, payload
            )
            try:
                self.journal.append([entry])
            except OSError:
                return  # a later order takes its place
            self._ordered[robot, topic.suffix] = payload
            self._tell_robot(robot, topic.suffix, payload)

    def _tell_robot(self, robot: str, suffix: str, payload: bytes) -> None:
        self._session.put(
            order_key(self.config.mission, robot, suffix),
            payload,
            congestion_control=zenoh.CongestionControl.DROP,
        )

    def _take_in(self, batch: list[Received]) -> None:
        accepted: list[Verdict] = []
        for received in batch:
            verdict = self.ingest.judge(
                received.key, received.attachment, received.payload, received.received_ns
            )
            if verdict.robot is None:
                continue
            if isinstance(verdict.outcome, LinkStatus):
                self._refuse(verdict, received)
                continue
            envelope = verdict.envelope
            assert envelope is not None
            if isinstance(verdict.outcome, Refusal):
                self._say(verdict.robot, verdict.outcome.name, verdict.outcome.sentence)
            if verdict.outcome is Arrival.ACCEPTED:
                accepted.append(verdict)
            if verdict.outcome is Arrival.GOODBYE:
                self._heard.pop(verdict.robot, None)
                self._due.discard(verdict.robot)
            elif not isinstance(verdict.outcome, Deferral):
                self._due.add(verdict.robot)
                self._heard[verdict.robot] = _Heard(envelope, received.received_ns, time.monotonic())
        if not accepted:
            return
        written = self._write(accepted)
        for verdict in accepted:
            self.ingest.settle(verdict, written)
            if written:
                self._note_clock(verdict)
                self._on_message(verdict)

    def _note_clock(self, verdict: Verdict) -> None:
        entry = verdict.entry
        if verdict.robot is not None and entry is not None and entry.msgtype == CLOCK.msgtype:
            self.clocks[verdict.robot] = recorded_offset(verdict.message)

    def _write(self, verdicts: list[Verdict]) -> bool:
        try:
            self.journal.append([v.entry for v in verdicts if v.entry is not None])
        except OSError as error:
            if not self.disk_problem:
                self._tell(
                    f"{self.config.out}: {error.strerror}; nothing more is acknowledged until there is room"
                )
            self.disk_problem = error.strerror or str(error)
            for verdict in verdicts:
                if verdict.robot is not None:
                    self.ingest.robots[verdict.robot].counts[Deferral.DISK_FULL.name] += 1
            return False
        if self.disk_problem:
            self._tell(f"{self.config.out}: there is room again")
            self.disk_problem = ""
        return True

    def _answer(self, robots: Collection[str], timed: bool) -> None:
        """Tell robots what of theirs is on disk.

        Args:
            robots: Who has been heard of.
            timed: Whether the answer also times the link; one that is said again does not.
        """
        for robot in robots:
            state, heard = self.ingest.robots[robot], self._heard[robot]
            settled = state.settled[heard.envelope.incarnation]
            heard.answered_s = time.monotonic()
            self._send(
                robot,
                Acknowledgement(
                    LinkStatus.OPEN,
                    self._id,
                    heard.envelope.incarnation,
                    heard.envelope.session,
                    heard.envelope.sent_ns if timed else NOT_TIMED_NS,
                    heard.received_ns,
                    time.time_ns(),
                    settled.through,
                    worth_telling(settled.beyond, state.recent),
                    list(state.refused),
                ),
            )

    def _unheard(self, now_s: float) -> set[str]:
        """Robots that may not know yet what they were answered."""
        return {
            robot
            for robot, heard in self._heard.items()
            if now_s - heard.answered_s >= _ANSWER_AGAIN_S
            and now_s - heard.heard_s < _ANSWER_FOR_S
            and self._knows_more(robot, heard.envelope)
        }

    def _knows_more(self, robot: str, envelope: Envelope) -> bool:
        """Whether something may be settled that the robot still waits for."""
        settled = self.ingest.robots[robot].settled[envelope.incarnation]
        never_answered = envelope.settled_below == 0
        return never_answered or bool(settled.beyond) or settled.through >= envelope.settled_below

    def _refuse(self, verdict: Verdict, received: Received) -> None:
        """Tell a session that it is not welcome, and why."""
        assert isinstance(verdict.outcome, LinkStatus)
        assert verdict.robot is not None
        if not self._say(verdict.robot, verdict.outcome.name, verdict.outcome.sentence):
            return
        envelope = verdict.envelope
        assert envelope is not None
        answer = Acknowledgement(
            verdict.outcome,
            self._id,
            envelope.incarnation,
            envelope.session,
            envelope.sent_ns,
            received.received_ns,
            time.time_ns(),
        )
        self._send(verdict.robot, answer)

    def _send(self, robot: str, answer: Acknowledgement) -> None:
        payload = answer.encode()
        self.answered_bytes[robot] = self.answered_bytes.get(robot, 0) + len(payload)
        self._session.put(
            acknowledgement_key(self.config.mission, robot),
            payload,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
        )

    def _say(self, robot: str, what: str, sentence: str) -> bool:
        """Tell a person, each half minute at most; whether it is time to tell the robot."""
        now_s = time.monotonic()
        last_s = self._told.get((robot, what), -1e9)
        if now_s - last_s < _REFUSE_EVERY_S:
            return False
        if len(self._told) > 4096:
            self._told.clear()  # an attacker's names must not fill the memory
        self._told[robot, what] = now_s
        if now_s - self._told.get((robot, f"person {what}"), -1e9) > 30.0:
            self._told[robot, f"person {what}"] = now_s
            self._tell(f"{robot}: {sentence}")
        return True
