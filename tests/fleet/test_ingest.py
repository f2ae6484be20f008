import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mulan.fleet.ingest import Ingest, IngestConfig
from mulan.fleet.journal import Journal
from mulan.fleet.refusals import Deferral, Intrusion, LinkStatus, Refusal
from mulan.fleet.verdict import GOODBYE, GREETING, Arrival, Verdict
from mulan.fleet.wire_topics import WIRE_TOPICS
from mulan.mission import messages
from mulan.mission.bag_reader import read_mission
from tests.fleet.conftest import (
    EPOCH_NS,
    Recorded,
    envelope_of,
    first_of,
    key_of,
    recorded_by,
)

ODOMETRY, IMAGE = messages.ODOMETRY.suffix, messages.IMAGE.suffix
UNLIMITED = IngestConfig(robots=("ant", "zebra"), messages_per_s=1e9, bytes_per_s=1e12)


def judge(ingest: Ingest, message: Recorded, sequence: int, now_s: float = 0.0, **changes: Any) -> Verdict:
    attachment = envelope_of(message, sequence, **changes)
    verdict = ingest.judge(key_of(message.suffix), attachment, message.payload, EPOCH_NS, now_s)
    if verdict.outcome is Arrival.ACCEPTED:
        ingest.settle(verdict)
    return verdict


def with_messages(recorded: list[Recorded], config: IngestConfig = UNLIMITED) -> Ingest:
    ingest = Ingest("m", config)
    for sequence, message in enumerate(recorded, 1):
        assert judge(ingest, message, sequence).outcome is Arrival.ACCEPTED
    return ingest


def test_every_message_of_a_robot_is_welcome_once(recorded: list[Recorded]) -> None:
    ingest = with_messages(recorded)
    for sequence, message in enumerate(recorded, 1):
        assert judge(ingest, message, sequence).outcome is Arrival.DUPLICATE
    state = ingest.robots["ant"]
    assert state.settled[77].through == len(recorded)
    assert not state.settled[77].beyond


def test_a_robot_writes_only_under_its_own_name(recorded: list[Recorded]) -> None:
    ingest, message = with_messages(recorded), first_of(recorded, ODOMETRY)
    for number, (key, expected) in enumerate(
        (
            (key_of(ODOMETRY, "zebra"), Intrusion.WRONG_SENDER),
            (key_of(ODOMETRY, "mole"), LinkStatus.UNKNOWN_ROBOT),
            (key_of(ODOMETRY, mission="n"), Intrusion.FOREIGN_KEY),
            ("mulan/m/base/ant/acknowledgement", Intrusion.FOREIGN_KEY),
            ("mulan/m/*/odom", Intrusion.FOREIGN_KEY),
            (key_of("cmd_vel"), Refusal.WRONG_TOPIC),
            (key_of("../zebra/odom"), Refusal.WRONG_TOPIC),
        )
    ):
        attachment = envelope_of(message, 99 + number)
        assert ingest.judge(key, attachment, message.payload, EPOCH_NS, 0.0).outcome is expected


def test_mounts_of_another_robot_are_refused(recorded: list[Recorded]) -> None:
    theirs = first_of(recorded_by("zebra", []), "tf_static")
    assert judge(with_messages(recorded), theirs, 99).outcome is Refusal.MALFORMED


def test_wrong_versions_types_and_times_are_named(recorded: list[Recorded]) -> None:
    ingest, message = with_messages(recorded), first_of(recorded, ODOMETRY)
    cases: tuple[tuple[dict[str, Any], object], ...] = (
        ({"version": 2}, LinkStatus.WRONG_VERSION),
        ({"type_hash": bytes(8)}, Refusal.WRONG_TYPE),
        ({"record_ns": message.record_ns + 1}, Refusal.MISTIMED),
        ({"record_ns": -1}, Refusal.MISTIMED),
        ({"sent_ns": message.record_ns - 2 * 10**9}, Refusal.MISTIMED),
        ({"sent_ns": message.record_ns + 90_000 * 10**9}, Refusal.MISTIMED),
    )
    for changes, expected in cases:
        sequence = ingest.robots["ant"].settled[77].through + 1
        assert judge(ingest, message, sequence, **changes).outcome is expected


def test_a_message_over_the_limit_is_refused(recorded: list[Recorded]) -> None:
    config = IngestConfig(robots=("ant", "zebra"), largest_message_bytes=900)
    ingest = Ingest("m", config)
    assert judge(ingest, Recorded(ODOMETRY, EPOCH_NS, bytes(901)), 1).outcome is Refusal.TOO_LARGE


def test_the_second_robot_of_a_name_is_told_and_the_first_goes_on(recorded: list[Recorded]) -> None:
    ingest, message = with_messages(recorded), first_of(recorded, ODOMETRY)
    assert judge(ingest, message, 1, now_s=1.0, incarnation=5).outcome is LinkStatus.NAME_TAKEN
    assert judge(ingest, message, 1, now_s=1.0, session=5).outcome is LinkStatus.NAME_TAKEN  # a copied spool
    assert judge(ingest, message, 1, now_s=4.0).outcome is Arrival.DUPLICATE
    assert judge(ingest, message, 1, now_s=8.0, incarnation=5).outcome is LinkStatus.NAME_TAKEN
    assert judge(ingest, message, 1, now_s=9.1, incarnation=5).outcome is Arrival.ACCEPTED


def test_goodbye_frees_the_name_at_once(recorded: list[Recorded]) -> None:
    ingest, message = with_messages(recorded), first_of(recorded, ODOMETRY)
    ingest.judge(key_of(GOODBYE), envelope_of(message, 0), b"", EPOCH_NS, 1.0)
    assert judge(ingest, message, 1, now_s=1.1, session=5).outcome is Arrival.DUPLICATE


def test_a_robot_beyond_its_rate_is_left_unanswered(recorded: list[Recorded]) -> None:
    ingest = Ingest("m", IngestConfig(messages_per_s=10, burst_s=1.0))
    message = first_of(recorded, ODOMETRY)
    outcomes = Counter(judge(ingest, message, n, now_s=1.0).outcome for n in range(1, 31))
    assert outcomes == {Arrival.ACCEPTED: 10, Deferral.TOO_FAST: 20}
    assert judge(ingest, message, 30, now_s=1.15).outcome is Arrival.ACCEPTED


def test_an_image_waits_for_its_calibration(recorded: list[Recorded]) -> None:
    ingest, image = Ingest("m", UNLIMITED), first_of(recorded, IMAGE)
    assert judge(ingest, image, 2).outcome is Deferral.CAMERA_UNKNOWN
    assert judge(ingest, recorded[0], 1).outcome is Arrival.ACCEPTED
    assert judge(ingest, image, 2).outcome is Arrival.ACCEPTED


@pytest.mark.parametrize(
    ("suffix", "spoil"),
    [
        (ODOMETRY, lambda m: setattr(m.pose.pose.position, "x", np.nan)),
        (ODOMETRY, lambda m: setattr(m.pose.pose.orientation, "w", 40.0)),
        (ODOMETRY, lambda m: m.pose.covariance.__setitem__(0, -1.0)),
        ("range", lambda m: setattr(m, "range_m", np.inf)),
        ("range", lambda m: setattr(m, "sigma_m", 0.0)),
        ("range", lambda m: setattr(m, "peer", "nobody")),
        ("csi", lambda m: setattr(m, "antennas", 3)),
        ("csi", lambda m: m.real.__setitem__(0, np.nan)),
        ("csi", lambda m: m.subcarrier_hz.__setitem__(0, 1.0)),
        ("camera/camera_info", lambda m: setattr(m, "width", 31)),
        (IMAGE, lambda m: setattr(m, "data", m.data[: len(m.data) // 2])),
        (IMAGE, lambda m: setattr(m, "data", np.zeros(50, np.uint8))),
    ],
)
def test_values_no_sensor_gives_are_refused(recorded: list[Recorded], suffix: str, spoil) -> None:
    store, message = messages.typestore(), first_of(recorded, suffix)
    msgtype = WIRE_TOPICS[suffix].topic.msgtype
    decoded = store.deserialize_cdr(memoryview(bytearray(message.payload)), msgtype)
    spoil(decoded)
    spoiled = Recorded(suffix, message.record_ns, bytes(store.serialize_cdr(decoded, msgtype)))
    assert judge(with_messages(recorded), spoiled, 99).outcome is Refusal.MALFORMED


def test_a_restart_remembers_what_was_written(tmp_path: Path, recorded: list[Recorded]) -> None:
    ingest, journal = Ingest("m", UNLIMITED), Journal(tmp_path / "m.mcap")
    for sequence, message in enumerate(recorded[:20], 1):
        entry = judge(ingest, message, sequence).entry
        assert entry is not None
        journal.append([entry])
    journal.abandon()
    again = Ingest("m", UNLIMITED)
    Journal(tmp_path / "m.mcap", replay=again.remember).abandon()
    assert again.robots["ant"].content.camera == ingest.robots["ant"].content.camera
    outcomes = [judge(again, message, n).outcome for n, message in enumerate(recorded, 1)]
    assert outcomes == [Arrival.DUPLICATE] * 20 + [Arrival.ACCEPTED] * (len(recorded) - 20)


@settings(max_examples=25)
@given(st.text(max_size=40), st.binary(max_size=120), st.binary(max_size=300))
def test_no_input_breaks_the_base_station(key: str, attachment: bytes, payload: bytes) -> None:
    ingest = Ingest("m", UNLIMITED)
    for k in (key, f"mulan/m/ant/{key}", key_of(GREETING)):
        for a in (None, attachment, b"MULN\x01\x00" + attachment):
            assert ingest.judge(k, a, payload, EPOCH_NS, 0.0).outcome is not Arrival.ACCEPTED


def test_ten_thousand_damaged_messages_leave_the_bag_readable(tmp_path: Path) -> None:
    """Bits flipped, bytes cut, repeated, swapped: what gets in is a mission all the same."""
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": f"{root / 'src'}:{root}"}
    # a process of its own: the shape checks of the test run would make it several times as long
    command = [sys.executable, "-m", "tests.fleet.damaged_messages", str(tmp_path / "m.mcap"), "10000"]
    run = subprocess.run(command, env=environment, cwd=root, capture_output=True, text=True, check=True)
    outcomes = json.loads(run.stdout)
    read_mission(tmp_path / "m.mcap")
    assert sum(outcomes.values()) == 10_000
    assert outcomes["MALFORMED"] > 2000
    assert outcomes.keys() >= {"MALFORMED", "MISTIMED", "WRONG_TYPE", "NO_ENVELOPE", "WRONG_VERSION"}
