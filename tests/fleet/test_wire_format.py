import pytest
from hypothesis import given
from hypothesis import strategies as st

from mulan.errors import InputError
from mulan.fleet import acknowledgement, envelope
from mulan.fleet.acknowledgement import Acknowledgement, worth_telling
from mulan.fleet.envelope import Envelope, EnvelopeError
from mulan.fleet.names import RobotKey, check_mission_name, check_robot_name, parse_robot_key
from mulan.fleet.refusals import LinkStatus, Refusal
from mulan.fleet.wire_topics import WIRE_TOPICS, type_hash

NUMBERS = st.integers(0, 2**63 - 1)
SEQUENCES = st.integers(0, 2**32 - 1)
NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,31}", fullmatch=True)


HASHES = st.binary(min_size=8, max_size=8)


@given(
    st.builds(Envelope, NAMES, NUMBERS, NUMBERS, SEQUENCES, SEQUENCES, HASHES, NUMBERS, NUMBERS, st.just(1))
)
def test_envelope_survives_the_wire(sent: Envelope) -> None:
    attachment = sent.encode()
    assert len(attachment) == 88
    assert envelope.decode(attachment) == sent


@given(st.binary(max_size=120))
def test_no_bytes_break_the_envelope(noise: bytes) -> None:
    for attachment in (noise, envelope.MAGIC + noise):
        try:
            found = envelope.decode(attachment)
        except EnvelopeError:
            continue
        assert len(attachment) == 88
        assert found.version == envelope.PROTOCOL_VERSION


def test_version_and_session_are_read_whatever_follows() -> None:
    attachment = Envelope("ant", 5, 6, 7, 0, bytes(8), 1, 2, version=9).encode()
    for text in (attachment, attachment[:30], attachment + b"more"):
        head = envelope.head_of(text)
        assert (head.version, head.incarnation, head.session) == (9, 5, 6)


@given(
    st.lists(st.tuples(SEQUENCES, SEQUENCES), max_size=9),
    st.lists(st.tuples(SEQUENCES, st.sampled_from(list(Refusal))), max_size=9),
)
def test_acknowledgement_survives_the_wire(
    beyond: list[tuple[int, int]], refused: list[tuple[int, Refusal]]
) -> None:
    sent = Acknowledgement(LinkStatus.OPEN, 1, 2, 3, -4, 5, 6, 7, tuple(beyond), refused)
    assert acknowledgement.decode(sent.encode()) == sent
    with pytest.raises(EnvelopeError):
        acknowledgement.decode(sent.encode() + b"x")


def test_an_answer_that_cannot_tell_all_tells_the_first_and_the_latest() -> None:
    many = [(3 * n, 3 * n + 1) for n in range(1, 500)]
    assert worth_telling(many[:100], [1]) == many[:100]
    told = worth_telling(many, [1498, 700, 4])
    assert len(told) <= acknowledgement.MOST_RANGES
    assert told[:100] == many[:100]
    assert told[-2:] == [(700, 700), (1498, 1498)]
    assert Acknowledgement(LinkStatus.OPEN, 1, 2, 3, 4, 5, 6, 7, told).encode()


def test_keys_name_mission_robot_and_topic() -> None:
    assert parse_robot_key("mulan/m-1/ant/camera/image/compressed") == RobotKey(
        "m-1", "ant", "camera/image/compressed"
    )
    for key in ("mulan/m/ant", "other/m/ant/odom", "mulan/m/base/ant/odom", "mulan/*/ant/odom", "mulan/m/**"):
        assert parse_robot_key(key) is None


@pytest.mark.parametrize("name", ["", "base", "held_out", "two words", "a/b", "*", "x" * 33, "9lives"])
def test_names_that_would_break_keys_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="robot name"):
        check_robot_name(name, "robot")


def test_mission_names_are_checked() -> None:
    check_mission_name("2026-11-27", "base station")
    with pytest.raises(InputError, match="mission name"):
        check_mission_name("a/b", "base station")


def test_type_hash_tells_types_apart() -> None:
    hashes = {type_hash(entry.topic.msgtype) for entry in WIRE_TOPICS.values()}
    assert len(hashes) == len(WIRE_TOPICS)
