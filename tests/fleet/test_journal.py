import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from mulan.errors import InputError
from mulan.fleet.journal import Entry, Journal, finish, sender_of
from mulan.fleet.journal_scan import RecordedMessage
from mulan.mission import bag_topics, messages
from mulan.mission.bag_reader import read_mission
from tests.fleet.conftest import EPOCH_NS, Recorded, recorded_by

TOPIC = messages.ODOMETRY


def entries_of(recorded: list[Recorded], robot: str = "ant", incarnation: int = 5) -> list[Entry]:
    from mulan.fleet.wire_topics import WIRE_TOPICS

    found = []
    for sequence, message in enumerate(recorded, 1):
        entry = WIRE_TOPICS[message.suffix]
        topic = entry.bag_topic(robot)
        received_ns = EPOCH_NS + sequence
        found.append(
            Entry(
                topic,
                entry.topic.msgtype,
                robot,
                incarnation,
                sequence,
                message.record_ns,
                received_ns,
                message.payload,
            )
        )
    return found


def numbers_in(path: Path) -> list[int]:
    found: list[RecordedMessage] = []
    Journal(path, replay=found.append).abandon()
    return [message.sequence for message in found]


def test_a_finished_journal_is_a_mission_every_reader_opens(tmp_path: Path, recorded: list[Recorded]) -> None:
    path = tmp_path / "m.mcap"
    journal = Journal(path)
    for robot, peers in (("ant", ["zebra"]), ("zebra", ["ant"])):
        journal.append(entries_of(recorded_by(robot, peers), robot))
    journal.close()
    mission = read_mission(path)
    assert [log.name for log in mission.robots] == ["ant", "zebra"]
    assert len(mission.robots[0].photos) == 3
    with path.open("rb") as file:  # a second reader, not the one MULAN uses
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 2 * len(recorded)
        file.seek(0)
        stored = [message.data for _, _, message in make_reader(file).iter_messages()]
    assert stored[: len(recorded)] == [message.payload for message in recorded]


@pytest.mark.parametrize("cut", [1, 9, 30, 200])
def test_a_cut_last_record_is_ignored_and_writing_goes_on(
    tmp_path: Path, recorded: list[Recorded], cut: int
) -> None:
    path, entries = tmp_path / "m.mcap", entries_of(recorded)
    journal = Journal(path)
    journal.append(entries[:10])
    journal.abandon()
    os.truncate(path, path.stat().st_size - cut)
    assert numbers_in(path) == list(range(1, 10))
    journal = Journal(path)
    journal.append(entries[9:])
    journal.close()
    assert numbers_in(path) == list(range(1, len(entries) + 1))
    with pytest.raises(InputError, match="cut short"):
        bag_topics.check_file(path)  # opening it again took the end off
    assert finish(path) == len(entries)
    bag_topics.check_file(path)


def test_damage_at_the_end_never_reaches_whole_messages(tmp_path: Path, recorded: list[Recorded]) -> None:
    """A power cut may leave zeros or old bytes after what was written."""
    path = tmp_path / "m.mcap"
    journal = Journal(path)
    journal.append(entries_of(recorded))
    journal.abandon()
    for garbage in (bytes(4096), os.urandom(4096), b"\x05" + b"\xff" * 60):
        with path.open("ab") as file:
            file.write(garbage)
        assert numbers_in(path) == list(range(1, len(recorded) + 1))


def test_a_file_cut_in_its_first_bytes_is_begun_anew(tmp_path: Path, recorded: list[Recorded]) -> None:
    path = tmp_path / "m.mcap"
    Journal(path).abandon()
    for size in (0, 3, 8, 12):
        os.truncate(path, size)
        journal = Journal(path)
        journal.append(entries_of(recorded)[:2])
        journal.close()
        assert numbers_in(path) == [1, 2]


def test_senders_and_numbers_are_found_again(tmp_path: Path, recorded: list[Recorded]) -> None:
    path = tmp_path / "m.mcap"
    journal = Journal(path)
    journal.append(entries_of(recorded, incarnation=2**63 - 1)[:3])
    journal.append(entries_of(recorded, incarnation=6)[:1])
    journal.close()
    found: list[RecordedMessage] = []
    Journal(path, replay=found.append).close()
    assert [(*sender_of(m), m.sequence) for m in found] == [
        *(("ant", 2**63 - 1, n) for n in (1, 2, 3)),
        ("ant", 6, 1),
    ]
    assert [m.payload for m in found[:3]] == [m.payload for m in recorded[:3]]


def test_a_full_disk_loses_nothing_written_before(tmp_path: Path, recorded: list[Recorded]) -> None:
    path, entries = tmp_path / "m.mcap", entries_of(recorded)
    journal = Journal(path)
    journal.append(entries[:5])
    size = path.stat().st_size
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, hard))
    try:
        with pytest.raises(OSError, match="large"):
            journal.append(entries[5:])
        assert path.stat().st_size == size
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    journal.append(entries[5:])
    journal.close()
    assert {*bag_topics.topic_names(path)} == {entry.topic for entry in entries}


def test_a_clock_set_back_leaves_the_bag_readable(tmp_path: Path, recorded: list[Recorded]) -> None:
    from dataclasses import replace

    path = tmp_path / "m.mcap"
    journal = Journal(path)
    late, early = entries_of(recorded)[:2]
    journal.append([replace(late, received_ns=EPOCH_NS + 10**12), early])
    journal.close()
    types = {entry.topic: entry.msgtype for entry in (late, early)}
    assert len(bag_topics.load(path, types).messages) == 2


def test_two_base_stations_cannot_write_one_bag(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "m.mcap")
    with pytest.raises(InputError, match="another base station"):
        Journal(tmp_path / "m.mcap")
    journal.close()


def test_foreign_files_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    path.write_bytes(b"something else entirely")
    with pytest.raises(InputError, match="not an MCAP"):
        Journal(path)
    assert path.read_bytes() == b"something else entirely"
    with pytest.raises(InputError, match=r"\.mcap"):
        Journal(tmp_path / "m.txt")


WRITER = """
import sys
from pathlib import Path
from tests.fleet.test_journal import entries_of
from tests.fleet.conftest import recorded_by
from dataclasses import replace
from mulan.fleet.journal import Journal
entries = entries_of(recorded_by("ant", ["zebra"]))
journal, number = Journal(Path(sys.argv[1]), durable=False), 0
while True:
    for entry in entries:
        number += 1
        journal.append([replace(entry, sequence=number)])
        print(number, flush=True)
"""


def test_kill_loses_nothing_that_was_said_to_be_written(tmp_path: Path) -> None:
    path = tmp_path / "m.mcap"
    root = Path(__file__).parents[2]
    environment = os.environ | {"PYTHONPATH": f"{root / 'src'}:{root}"}
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, env=environment, text=True
    )
    assert process.stdout is not None
    said = [int(process.stdout.readline()) for _ in range(500)]
    process.send_signal(signal.SIGKILL)
    said += [int(line) for line in process.stdout.read().splitlines(keepends=True) if line.endswith("\n")]
    process.wait()
    found = numbers_in(path)
    assert found[: len(said)] == said
    assert len(found) <= len(said) + 1
