"""A mission written to a base station's bag bit by bit."""

from pathlib import Path

from rosbags.rosbag2 import Reader

from mulan.fleet.journal import Entry, Journal
from mulan.mission.bag_writer import write_mission
from mulan.mission.types import Mission


def entries_of(mission: Mission, folder: Path) -> list[Entry]:
    """Every message of a mission's robots as a base station would write it, in order of time."""
    bag = folder / "recorded.mcap"
    write_mission(Mission(mission.robots), bag)
    with Reader(bag) as reader:
        return [
            Entry(connection.topic, connection.msgtype, "", 0, 0, time_ns, time_ns, bytes(data))
            for connection, time_ns, data in reader.messages()
        ]


def append_until(journal: Journal, entries: list[Entry], share: float) -> list[Entry]:
    """Write the messages of the first part of the time; returns the rest."""
    begin_ns, end_ns = entries[0].record_ns, entries[-1].record_ns
    count = sum(entry.record_ns <= begin_ns + share * (end_ns - begin_ns) for entry in entries)
    journal.append(entries[:count])
    return entries[count:]
