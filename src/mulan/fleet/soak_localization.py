"""What localization makes of the bag a base station received, beside the undisturbed one."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mulan.errors import InputError
from mulan.fleet.growing_bag import GrowingBag
from mulan.fleet.journal import Entry, Journal
from mulan.fleet.journal_scan import JournalScan, RecordedMessage, scan
from mulan.localization.accuracy import accuracy
from mulan.localization.localize import LocalizationConfig, localize
from mulan.localization.types import Localization
from mulan.mission.types import Mission
from mulan.wireless.bearing import BearingConfig


def compared(undisturbed: Mission, received: Mission) -> dict[str, Any]:
    """Errors from both bags, and how far the two solutions are apart."""
    solved = {}
    figures: dict[str, Any] = {}
    for name, mission in (("undisturbed", undisturbed), ("received", received)):
        localization = localize(mission, LocalizationConfig(), BearingConfig())
        solved[name] = localization
        figures[name] = _errors(localization, mission) | {"bearings": len(localization.bearings)}
    figures["largest_difference_m"] = _largest_difference_m(solved)
    return figures


def as_it_arrived(
    bag: Path, instants: int, scratch: Path, bearings: BearingConfig | None = None
) -> list[dict[str, Any]]:
    """What could be said at some instants, evenly spread over the time messages came.

    Args:
        bag: What the base station received.
        instants: How many.
        scratch: A folder for copies of the bag's beginning.
        bearings: How bearings are found; the default if not given.

    Returns:
        A record an instant: minutes since the first message, messages, robots placed of those heard, errors.
    """
    info = JournalScan()
    recorded = list(scan(bag, info))
    types = {c.id: info.schemas[c.schema_id].name for c in info.channels.values()}
    begin_ns, end_ns = recorded[0].log_ns, recorded[-1].log_ns
    told = []
    for share in np.arange(1, instants + 1) / instants:
        until_ns = begin_ns + share * (end_ns - begin_ns)
        part = [message for message in recorded if message.log_ns <= until_ns]
        record = {"minutes": share * (end_ns - begin_ns) * 1e-9 / 60, "messages": len(part)}
        copy = scratch / "beginning.mcap"
        told.append(record | _of_part(part, types, copy, bearings or BearingConfig()))
    return told


def _of_part(
    part: Sequence[RecordedMessage], types: Mapping[int, str], copy: Path, bearings: BearingConfig
) -> dict[str, Any]:
    copy.unlink(missing_ok=True)
    journal = Journal(copy, durable=False)
    journal.append([_entry(message, types[message.channel.id]) for message in part])
    journal.abandon()
    growing = GrowingBag(copy)
    growing.read()
    copy.unlink()
    nobody = {"placed": 0, "position_rms_m": {}}
    try:
        mission = growing.mission()
        if mission is None:
            return nobody
        return _errors(localize(mission, LocalizationConfig(), bearings), mission)
    except InputError:
        return nobody  # a recording's beginning can be of no use by itself


def _entry(message: RecordedMessage, msgtype: str) -> Entry:
    return Entry(message.channel.topic, msgtype, "", 0, 0, message.record_ns, message.log_ns, message.payload)


def _errors(localization: Localization, mission: Mission) -> dict[str, Any]:
    found = accuracy(localization, mission) or {}
    return {
        "placed": len(localization.trajectories),
        "photographs": sum(len(t.time_s) for t in localization.trajectories.values()),
        "position_rms_m": {robot: f.position_rms_m for robot, f in found.items()},
        "yaw_rms_deg": {robot: f.yaw_rms_deg for robot, f in found.items()},
    }


def _largest_difference_m(solved: Mapping[str, Localization]) -> float | None:
    """Between the two solutions, over the photographs both have."""
    apart = []
    one, other = solved["undisturbed"].trajectories, solved["received"].trajectories
    for robot in one.keys() & other.keys():
        _, first, second = np.intersect1d(
            np.round(one[robot].time_s * 1e6), np.round(other[robot].time_s * 1e6), return_indices=True
        )
        off = one[robot].T_world_body[first, :3, 3] - other[robot].T_world_body[second, :3, 3]
        apart += list(np.linalg.norm(off, axis=1))
    return float(max(apart)) if apart else None
