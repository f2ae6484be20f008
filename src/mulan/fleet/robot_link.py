"""A robot's side of the link: everything goes to the spool first and stays until the base station has it."""

import secrets
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from mulan.fleet import acknowledgement as answers
from mulan.fleet.acknowledgement import NOT_TIMED_NS, Acknowledgement
from mulan.fleet.clock_offset import ClockEstimator
from mulan.fleet.clock_record import clock_record
from mulan.fleet.content_checks import to_ns
from mulan.fleet.envelope import PROTOCOL_VERSION, Envelope, EnvelopeError
from mulan.fleet.lossy_link import LossConfig, LossyLink
from mulan.fleet.names import (
    RobotKey,
    acknowledgement_key,
    check_mission_name,
    check_robot_name,
    order_key,
)
from mulan.fleet.refusals import LinkStatus
from mulan.fleet.send_window import SendWindow, WindowConfig
from mulan.fleet.spool import Spool, Spooled, Unsent
from mulan.fleet.verdict import GOODBYE, GREETING
from mulan.fleet.wire_topics import CLOCK, WIRE_TOPICS, Importance, type_hash
from mulan.fleet.zenoh_session import LinkConfig, open_robot_session
from mulan.mission import messages
from mulan.mission.messages import Topic

_GREET_EVERY_S = 1.0
_KNOCK_EVERY_S = 0.25  # until the base station has answered for the first time
_REFUSED_EVERY_S = 2.0
_STAMPS_KEPT = 16_384


@dataclass(frozen=True)
class RobotConfig:
    """Who a robot is, where its messages wait, and how they are sent."""

    name: str
    """Name of the robot: the first part of its topics."""
    spool: Path
    """File in which messages wait until the base station has them."""
    mission: str = "mission"
    """Name of the mission, as the base station has it."""
    spool_mb: float = 2000.0
    """Room for waiting messages; when it is used up the oldest images go first."""
    clock_every_s: float = 10.0
    """How often the offset to the base station's clock is recorded."""
    link: LinkConfig = field(default_factory=LinkConfig)
    """Network."""
    window: WindowConfig = field(default_factory=WindowConfig)
    """How much is under way at once, and when it is sent again."""
    loss: LossConfig = field(default_factory=LossConfig)
    """A bad radio link in software, for trials."""


@dataclass
class LinkCounts:
    """What a link has done since its process started.

    Attributes:
        sent: Copies handed to the network, greetings apart.
        resent: Of these, not the first ones.
        stored: Messages the base station says are on its disk.
        refused: By reason.
        sent_bytes: Payload, attachment and key of every copy, by importance.
        range_bytes: Of these, those of ranges by peer.
        received_bytes: Answers.
        bases: Base station processes heard of.
    """

    sent: int = 0
    resent: int = 0
    stored: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    sent_bytes: Counter[Importance] = field(default_factory=Counter)
    range_bytes: Counter[str] = field(default_factory=Counter)
    received_bytes: int = 0
    bases: int = 0


class RobotLink:
    """Store and forward to the base station.

    Attributes:
        config: Options.
        spool: Where messages wait.
        counts: What happened.
        status: How the base station sees this session; None until it has answered.
        heard_s: When it last did, on the monotonic clock.
        clock: Offset of the base station's clock.
    """

    def __init__(
        self,
        config: RobotConfig,
        clock_ns: Callable[[], int] = time.time_ns,
        tell: Callable[[str], object] = lambda _: None,
        version: int = PROTOCOL_VERSION,
        orders: Mapping[Topic, Callable[[Any], object]] | None = None,
    ) -> None:
        """Open the spool and the network; sending begins at once.

        Args:
            config: Options.
            clock_ns: The robot's clock, the one its messages are stamped with.
            tell: Called with a sentence when something happens that a person should know.
            version: Protocol version to claim; for tests.
            orders: By topic, what is called with every message the base station sends on it, the same one
                again and again; by a thread of its own.

        Raises:
            InputError: A name or the endpoint is not valid, or the spool cannot be used.
        """
        check_robot_name(config.name, "robot")
        check_mission_name(config.mission, "robot")
        self.config = config
        self.counts = LinkCounts()
        self.status: LinkStatus | None = None
        self.heard_s = -1e9
        self.clock = ClockEstimator()
        self._clock_ns, self._tell, self._version = clock_ns, tell, version
        self._session_id = secrets.randbits(63)
        self._base: int | None = None
        self._sent_s: dict[int, float] = {}
        self._clock_recorded_s = time.monotonic()
        self._greeted_s = -1e9
        self._changed = threading.Condition()
        self._closing = False
        self.spool = Spool(config.spool, int(config.spool_mb * 1e6))
        self._window = SendWindow(config.window, self.spool)
        try:
            self._session = open_robot_session(config.link, config.name)
        except BaseException:
            self.spool.close()
            raise
        self._out = LossyLink(config.loss, self._put, 0)
        self._in = LossyLink(config.loss, self._hear, 1)
        self._orders_in: list[LossyLink[bytes]] = []
        self._subscriber = self._session.declare_subscriber(
            acknowledgement_key(config.mission, config.name), lambda s: self._in.send(s.payload.to_bytes())
        )
        self._order_subscribers = [self._listen(topic, act) for topic, act in (orders or {}).items()]
        self._thread = threading.Thread(target=self._work, name=f"link of {config.name}", daemon=True)
        self._thread.start()

    def send(self, suffix: str, message: Any, position: int = 0) -> None:
        """Record a message and send it as soon as the link allows; when this returns it is on disk here.

        Args:
            suffix: Of its topic, one of ``WIRE_TOPICS``.
            message: A ROS message of the topic's type.
            position: Where the message's source stands after it.

        Raises:
            OSError: The spool's disk is full.
        """
        entry = WIRE_TOPICS[suffix]
        payload = bytes(messages.typestore().serialize_cdr(message, entry.topic.msgtype))
        header = getattr(message, "header", None)
        if entry.importance is Importance.CALIBRATION or header is None:
            record_ns = self._clock_ns()
        else:
            record_ns = to_ns(header.stamp)
        self.send_all([Unsent(entry.importance, suffix, record_ns, payload)], position)

    def send_encoded(self, suffix: str, record_ns: int, payload: bytes) -> None:
        """The same for CDR bytes; the time must be the one in the message's header."""
        self.send_all([Unsent(WIRE_TOPICS[suffix].importance, suffix, record_ns, payload)])

    def send_all(self, unsent: Sequence[Unsent], position: int = 0) -> None:
        """The same for several messages, of which either all or none are kept."""
        self.spool.add_all(unsent, position)
        with self._changed:
            self._changed.notify()

    def drained(self, timeout_s: float) -> bool:
        """Wait until the base station has everything; whether it has."""
        until_s = time.monotonic() + timeout_s
        while len(self.spool):
            if time.monotonic() > until_s:
                return False
            time.sleep(0.02)
        return True

    def close(self) -> None:
        """Say goodbye and stop; what still waits is sent when the spool is opened again."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        self._transmit(GOODBYE, 0, 0, b"")
        time.sleep(self.config.loss.delay_s + self.config.loss.jitter_s)
        self._out.close()
        self._in.close()
        for link in self._orders_in:
            link.close()
        self._session.close()
        self.spool.close()

    @property
    def under_way(self) -> int:
        """Messages sent and not yet acknowledged."""
        return len(self._window)

    def _work(self) -> None:
        while True:
            with self._changed:
                if self._closing:
                    return
                now_s = time.monotonic()
                # before any answer too: on a bad link it may take minutes to come
                due = self._window.due(now_s) if self.status in (None, LinkStatus.OPEN) else []
                if not due:
                    self._changed.wait(self._window.pause_s(now_s))
            for message, again in due:
                self._send_one(message, again)
            self._greet(bool(due))
            self._record_clock()

    def _send_one(self, message: Spooled, again: bool) -> None:
        size = self._transmit(message.suffix, message.sequence, message.record_ns, message.payload)
        self.counts.sent += 1
        self.counts.resent += again
        self.counts.sent_bytes[message.importance] += size
        if message.suffix == messages.RANGE.suffix:
            ranged: Any = messages.typestore().deserialize_cdr(message.payload, messages.RANGE.msgtype)
            self.counts.range_bytes[ranged.peer] += size

    def _greet(self, sending: bool) -> None:
        """Open the session, and keep the name while there is nothing to send."""
        now_s = time.monotonic()
        if sending and self.status is LinkStatus.OPEN:
            self._greeted_s = now_s
        elif now_s - self._greeted_s > self._greet_every_s:
            self._greeted_s = now_s
            size = self._transmit(GREETING, 0, self._clock_ns(), b"")
            self.counts.sent_bytes[Importance.COORDINATION] += size

    @property
    def _greet_every_s(self) -> float:
        if self.status is None:
            return _KNOCK_EVERY_S
        return _GREET_EVERY_S if self.status is LinkStatus.OPEN else _REFUSED_EVERY_S

    def _transmit(self, suffix: str, sequence: int, record_ns: int, payload: bytes) -> int:
        config = self.config
        topic = WIRE_TOPICS.get(suffix)
        settled = 0 if self.status is None else self.spool.settled_below
        sent_ns = self._clock_ns()
        self._sent_s[sent_ns] = time.monotonic()
        if len(self._sent_s) > _STAMPS_KEPT:
            self._sent_s.pop(next(iter(self._sent_s)))
        envelope = Envelope(
            config.name,
            self.spool.incarnation,
            self._session_id,
            sequence,
            min(settled, sequence) if sequence else settled,
            bytes(8) if topic is None else type_hash(topic.topic.msgtype),
            record_ns,
            sent_ns,
            self._version,
        ).encode()
        key = str(RobotKey(config.mission, config.name, suffix))
        self._out.send((key, payload, envelope))
        return len(key) + len(payload) + len(envelope)

    def _put(self, item: tuple[str, bytes, bytes]) -> None:
        key, payload, attachment = item
        self._session.put(
            key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.DROP
        )

    def _hear(self, payload: bytes) -> None:
        returned_ns = self._clock_ns()
        try:
            answer = answers.decode(payload)
        except EnvelopeError:
            return
        self.counts.received_bytes += len(payload)
        if (answer.incarnation, answer.session) != (self.spool.incarnation, self._session_id):
            return
        with self._changed:
            self._heed(answer, returned_ns)
            self._changed.notify()

    def _listen(self, topic: Topic, act: Callable[[Any], object]) -> zenoh.Subscriber[Any]:
        """Call with what the base station says on a topic."""

        def hear(payload: bytes) -> None:
            try:
                order = messages.typestore().deserialize_cdr(payload, topic.msgtype)
            except Exception:  # generated code: short data surfaces as whatever the field's reader raises
                return
            act(order)

        link = LossyLink(self.config.loss, hear, 2 + len(self._orders_in))
        self._orders_in.append(link)
        return self._session.declare_subscriber(
            order_key(self.config.mission, self.config.name, topic.suffix),
            lambda sample: link.send(sample.payload.to_bytes()),
        )

    def _heed(self, answer: Acknowledgement, returned_ns: int) -> None:
        now_s = time.monotonic()
        if answer.status is not self.status:
            self._tell(f"{self.config.name}: {answer.status.sentence}")
        self.status = answer.status
        if answer.status is not LinkStatus.OPEN:
            return
        if answer.base != self._base:
            if self._base is not None:
                self._window.hurry()  # a new process has nothing of what was on its way to the old one
            self._base = answer.base
            self.counts.bases += 1
        elif now_s - self.heard_s > 2 * _GREET_EVERY_S:
            self._window.hurry()
        self.heard_s = now_s
        self._window.heard(now_s)
        if answer.sent_ns != NOT_TIMED_NS:
            self.clock.add(answer.sent_ns, answer.received_ns, answer.answered_ns, returned_ns)
        sent_s = self._sent_s.get(answer.sent_ns)
        if sent_s is not None:
            self._window.round_trip(now_s - sent_s)
        stored, refused = self.spool.settle(answer.through, answer.beyond, answer.refused)
        self.counts.stored += stored
        for sequence, why in refused:
            self.counts.refused[why.name] += 1
            self._tell(f"{self.config.name}: message {sequence} was refused: {why.sentence}")
        self._window.settle(answer.through, answer.beyond, [n for n, _ in answer.refused])

    def _record_clock(self) -> None:
        """The offset goes into the bag as a message like any other."""
        now_s = time.monotonic()
        estimate = self.clock.estimate
        if estimate is None or now_s - self._clock_recorded_s < self.config.clock_every_s:
            return
        self._clock_recorded_s = now_s
        try:
            self.send(CLOCK.suffix, clock_record(self.config.name, estimate, self._clock_ns()))
        except ValueError:
            return
        except OSError:
            return  # the disk is full; whoever records sensor messages is told
