"""What the base station lets in: every message judged before a byte of it is written."""

import time
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any

from mulan.fleet import envelope as envelopes
from mulan.fleet.acknowledgement import MOST_RANGES
from mulan.fleet.content_checks import ContentChecks, to_ns
from mulan.fleet.envelope import Envelope, EnvelopeError
from mulan.fleet.journal import Entry, sender_of
from mulan.fleet.journal_scan import RecordedMessage
from mulan.fleet.names import is_robot_name, parse_robot_key
from mulan.fleet.refusals import Deferral, Intrusion, LinkStatus, Refusal
from mulan.fleet.sequence_set import SequenceSet
from mulan.fleet.token_bucket import TokenBucket
from mulan.fleet.verdict import GOODBYE, GREETING, Arrival, Outcome, Verdict
from mulan.fleet.wire_topics import MOUNTS, WIRE_TOPICS, Importance, WireTopic, type_hash
from mulan.mission import messages

_NS_PER_S = 1_000_000_000
_MOST_REFUSED = 128


@dataclass(frozen=True)
class IngestConfig:
    """Limits on what robots may send."""

    robots: tuple[str, ...] = ()
    """Robots of the mission, the anchor first; without them any name is welcome, in alphabetical order."""
    most_robots: int = 32
    """Without a list: so many names at most."""
    largest_message_bytes: int = 4_000_000
    """A larger message is refused."""
    messages_per_s: float = 2000.0
    """A robot's messages beyond this rate are left unanswered."""
    bytes_per_s: float = 20e6
    """The same for its bytes."""
    burst_s: float = 2.0
    """So many seconds' worth may come at once."""
    lease_s: float = 5.0
    """A name is free again when its robot has been silent this long."""
    clock_slack_s: float = 1.0
    """A message may claim to be recorded this much after it was sent."""
    oldest_s: float = 86400.0
    """A message recorded longer than this before it was sent is refused."""
    furthest_ahead: int = 100_000
    """Sequence numbers this far beyond the first gap are left unanswered."""


@dataclass
class RobotState:
    """What the base station knows about one robot.

    Attributes:
        content: What its messages promised.
        message_rate, byte_rate: Limits.
        holder: Incarnation and session the name belongs to.
        heard_s: When something last came from the holder.
        settled: Sequence numbers on disk or refused, by incarnation.
        unwritten: Numbers accepted, by incarnation, that are not on disk yet.
        recent: The last numbers that came and are settled, of the holder.
        refused: Numbers refused that the robot may not know of yet, of the holder.
        counts: How often each outcome occurred.
        received_bytes: Payload, attachment and key of every copy that came, by importance.
        range_bytes: Those of ranges by peer.
    """

    content: ContentChecks
    message_rate: TokenBucket
    byte_rate: TokenBucket
    holder: tuple[int, int] | None = None
    heard_s: float = 0.0
    settled: dict[int, SequenceSet] = field(default_factory=dict)
    unwritten: set[tuple[int, int]] = field(default_factory=set)
    recent: deque[int] = field(default_factory=lambda: deque(maxlen=MOST_RANGES // 2))
    refused: deque[tuple[int, Refusal]] = field(default_factory=deque)
    counts: Counter[str] = field(default_factory=Counter)
    received_bytes: Counter[Importance] = field(default_factory=Counter)
    range_bytes: Counter[str] = field(default_factory=Counter)


class Ingest:
    """Judges messages; holds all that judging needs and nothing of the network or the disk.

    Attributes:
        config: Limits.
        mission: Name of the mission.
        robots: What is known of each robot.
        intrusions: Input no robot of this mission sends, by kind.
    """

    def __init__(self, mission: str, config: IngestConfig) -> None:
        self.config = config
        self.mission = mission
        self.robots: dict[str, RobotState] = {}
        self.intrusions: Counter[str] = Counter()

    def remember(self, recorded: RecordedMessage) -> None:
        """Take note of a message already in the bag."""
        robot, incarnation = sender_of(recorded)
        suffix = recorded.channel.topic.removeprefix(f"/{robot}/").removeprefix("/")
        if not robot or suffix not in WIRE_TOPICS:
            return
        state = self._state(robot)
        state.settled.setdefault(incarnation, SequenceSet()).add(recorded.sequence)
        topic = WIRE_TOPICS[suffix]
        if topic.topic in (messages.CAMERA_INFO, MOUNTS, messages.CSI):
            store = messages.typestore()
            state.content.remember(topic, store.deserialize_cdr(recorded.payload, topic.topic.msgtype))

    def judge(
        self,
        key: str,
        attachment: bytes | None,
        payload: bytes,
        received_ns: int,
        now_s: float | None = None,
    ) -> Verdict:
        """What to do with a message. Whatever the bytes are, this returns.

        Args:
            key: Zenoh key it came under.
            attachment: The bytes beside it.
            payload: Its CDR bytes.
            received_ns: When it came, on the base station's clock.
            now_s: A clock that never goes back.
        """
        now_s = time.monotonic() if now_s is None else now_s
        try:
            head = envelopes.head_of(attachment or b"")
        except EnvelopeError:
            return self._intruded(Intrusion.NO_ENVELOPE)
        parsed = parse_robot_key(key)
        if parsed is None or parsed.mission != self.mission:
            return self._intruded(Intrusion.FOREIGN_KEY)
        if not self._is_known(parsed.robot):
            self.intrusions[LinkStatus.UNKNOWN_ROBOT.name] += 1
            return Verdict(LinkStatus.UNKNOWN_ROBOT, parsed.robot, head)
        state = self._state(parsed.robot)
        if head.version != envelopes.PROTOCOL_VERSION:
            return self._counted(state, Verdict(LinkStatus.WRONG_VERSION, parsed.robot, head))
        try:
            envelope = envelopes.decode(attachment or b"")
        except EnvelopeError:
            return self._intruded(Intrusion.NO_ENVELOPE)
        # a greeting has no number of its own
        ahead = bool(envelope.sequence) and envelope.settled_below > envelope.sequence
        if envelope.sender != parsed.robot or ahead:
            return self._intruded(Intrusion.WRONG_SENDER)
        verdict = self._of_robot(state, parsed.suffix, envelope, payload, received_ns, now_s)
        topic = WIRE_TOPICS.get(parsed.suffix)
        importance = Importance.COORDINATION if topic is None else topic.importance
        state.received_bytes[importance] += len(key) + len(attachment or b"") + len(payload)
        return self._counted(state, verdict)

    def settle(self, verdict: Verdict, written: bool = True) -> None:
        """An accepted message is on disk, or could not be written and is to come again."""
        assert verdict.envelope is not None
        assert verdict.robot is not None
        state, envelope = self.robots[verdict.robot], verdict.envelope
        state.unwritten.discard((envelope.incarnation, envelope.sequence))
        if written:
            state.settled.setdefault(envelope.incarnation, SequenceSet()).add(envelope.sequence)
            state.recent.append(envelope.sequence)

    def _of_robot(
        self,
        state: RobotState,
        suffix: str,
        envelope: Envelope,
        payload: bytes,
        received_ns: int,
        now_s: float,
    ) -> Verdict:
        robot = state.content.robot

        def verdict(outcome: Outcome) -> Verdict:
            return Verdict(outcome, robot, envelope)

        holder = envelope.incarnation, envelope.session
        if state.holder != holder:
            if state.holder is not None and now_s - state.heard_s < self.config.lease_s:
                return verdict(LinkStatus.NAME_TAKEN)
            state.holder = holder
            state.refused.clear()
            state.recent.clear()
        state.heard_s = now_s
        settled = state.settled.setdefault(envelope.incarnation, SequenceSet())
        settled.settle_below(envelope.settled_below)
        while state.refused and state.refused[0][0] < envelope.settled_below:
            state.refused.popleft()
        if suffix == GREETING:
            return verdict(Arrival.GREETING)
        if suffix == GOODBYE:
            state.holder = None
            return verdict(Arrival.GOODBYE)
        if envelope.sequence in settled or (envelope.incarnation, envelope.sequence) in state.unwritten:
            if envelope.sequence in settled and envelope.sequence not in state.recent:
                state.recent.append(envelope.sequence)  # the robot does not know it
            return verdict(Arrival.DUPLICATE)
        if envelope.sequence > settled.through + self.config.furthest_ahead or (
            len(state.refused) >= _MOST_REFUSED
        ):
            return verdict(Deferral.TOO_FAR_AHEAD)
        if not (state.message_rate.take(1, now_s) and state.byte_rate.take(len(payload), now_s)):
            return verdict(Deferral.TOO_FAST)
        found = self._message(state, suffix, envelope, payload)
        if isinstance(found, Refusal):
            settled.add(envelope.sequence)
            state.refused.append((envelope.sequence, found))
            return verdict(found)
        if isinstance(found, Deferral):
            return verdict(found)
        topic, message = found
        entry = Entry(
            topic.bag_topic(robot),
            topic.topic.msgtype,
            robot,
            envelope.incarnation,
            envelope.sequence,
            envelope.record_ns,
            received_ns,
            payload,
        )
        state.unwritten.add((envelope.incarnation, envelope.sequence))
        if topic.topic == messages.RANGE:
            state.range_bytes[message.peer] += len(payload)
        return Verdict(Arrival.ACCEPTED, robot, envelope, entry, message)

    def _message(
        self, state: RobotState, suffix: str, envelope: Envelope, payload: bytes
    ) -> tuple[WireTopic, Any] | Refusal | Deferral:
        topic = WIRE_TOPICS.get(suffix)
        if topic is None or envelope.sequence == 0:
            return Refusal.WRONG_TOPIC
        if envelope.type_hash != type_hash(topic.topic.msgtype):
            return Refusal.WRONG_TYPE
        if len(payload) > self.config.largest_message_bytes:
            return Refusal.TOO_LARGE
        slack_ns, oldest_ns = (int(s * _NS_PER_S) for s in (self.config.clock_slack_s, self.config.oldest_s))
        age_ns = envelope.sent_ns - envelope.record_ns
        if envelope.record_ns < 0 or not -slack_ns <= age_ns <= oldest_ns:
            return Refusal.MISTIMED
        try:
            message: Any = messages.typestore().deserialize_cdr(payload, topic.topic.msgtype)
        except Exception:  # generated code: damaged bytes surface as whatever a field's reader raises
            return Refusal.MALFORMED
        if topic.importance is not Importance.CALIBRATION:
            try:
                if to_ns(message.header.stamp) != envelope.record_ns:
                    return Refusal.MISTIMED
            except ValueError:
                return Refusal.MISTIMED
        problem = state.content.check(topic, message, self.config.robots)
        if problem is not None:
            return problem
        state.content.remember(topic, message)
        return topic, message

    def _is_known(self, robot: str) -> bool:
        if self.config.robots:
            return robot in self.config.robots
        return robot in self.robots or (is_robot_name(robot) and len(self.robots) < self.config.most_robots)

    def _state(self, robot: str) -> RobotState:
        if robot not in self.robots:
            config = self.config
            self.robots[robot] = RobotState(
                ContentChecks(robot),
                TokenBucket(config.messages_per_s, config.messages_per_s * config.burst_s),
                TokenBucket(config.bytes_per_s, config.bytes_per_s * config.burst_s),
            )
        return self.robots[robot]

    def _counted(self, state: RobotState, verdict: Verdict) -> Verdict:
        state.counts[verdict.outcome.name] += 1
        return verdict

    def _intruded(self, why: Intrusion) -> Verdict:
        self.intrusions[why.name] += 1
        return Verdict(why)
