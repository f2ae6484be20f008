"""A fleet on loopback through loss, jitter and kills, and what of its messages was lost."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader

from mulan.errors import InputError
from mulan.evaluation.provenance import provenance
from mulan.fleet.journal import Journal, sender_of
from mulan.fleet.journal_scan import RecordedMessage
from mulan.fleet.lossy_link import LossConfig
from mulan.fleet.soak_processes import (
    Kill,
    Member,
    base_member,
    free_endpoint,
    robot_member,
    start_all,
    watch,
)
from mulan.fleet.spool import Spool
from mulan.localization.accuracy import accuracy
from mulan.localization.localize import LocalizationConfig, localize
from mulan.localization.types import Localization
from mulan.mission.bag_reader import read_mission
from mulan.mission.run_folder import write_json
from mulan.mission.types import Mission
from mulan.wireless.bearing import BearingConfig

_REPLAYED = 0.85  # of the test's time; what was missed is sent in the rest


@dataclass(frozen=True)
class SoakConfig:
    """A base station and the robots of a bag, with faults."""

    bag: Path
    """Mission the robots replay."""
    out: Path
    """Folder to write; metrics.json lies in it."""
    minutes: float = 3.0
    """How long; the bag is replayed in 85 % of it, slower or faster than it was recorded."""
    loss: float = 0.2
    """Messages lost, each way."""
    jitter_s: float = 0.2
    """Random delay, each way, up to this."""
    duplicate: float = 0.02
    """Messages that come twice."""
    robot_away_s: float = 300.0
    """The second robot is killed for this long, or a sixth of the test if that is shorter."""
    base_kills: int = 2
    """How often the base station is killed."""
    localize: bool = True
    """Localize from the received bag and from the undisturbed one, and compare."""
    seed: int = 0
    """Source of the link's randomness."""


def soak(config: SoakConfig, stage: Callable[[str], object] = lambda _: None) -> dict[str, Any]:
    """Run the test; the figures are also in ``metrics.json``.

    Args:
        config: Options.
        stage: Called with what begins.

    Raises:
        InputError: The bag is not a mission, the folder holds an earlier test, or a process failed.
    """
    mission = read_mission(config.bag)
    names = tuple(robot.name for robot in mission.robots)
    if len(names) < 2:
        raise InputError(config.bag, "robots", "are fewer than two", "simulate a mission with two or more")
    folder, received = config.out, config.out / "mission.mcap"
    if received.exists():
        raise InputError(folder, "folder", "holds an earlier test", "choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    with Reader(config.bag) as reader:
        duration_s = reader.duration * 1e-9
    test_s = config.minutes * 60
    endpoint = free_endpoint()
    base = base_member(folder, received, endpoint, names)
    robots = [
        robot_member(
            folder,
            name,
            config.bag,
            duration_s / (test_s * _REPLAYED),
            endpoint,
            LossConfig(config.loss, config.duplicate, 0.002, config.jitter_s, config.seed + index),
        )
        for index, name in enumerate(names)
    ]
    away_s = min(config.robot_away_s, test_s / 6)
    kills = [Kill(robots[1], 0.15 * test_s, 0.15 * test_s + away_s)]
    for at in np.linspace(0.4, 0.75, config.base_kills):
        kills.append(
            Kill(base, float(at) * test_s, float(at) * test_s + min(10.0, test_s / 30), 0.1 * test_s)
        )
    stage(f"{len(names)} robots for {config.minutes:g} min")
    members = [base, *robots]
    try:
        start_all(members, 300)
        took_s = watch(members, kills, 3 * test_s + 300)
    finally:
        for member in reversed(members):
            member.stop(20)
    for member in members:
        if member.failed:
            raise InputError(folder, member.name, f"failed ({member.said()})", "see its .log files")
    metrics = {
        "provenance": provenance(config.seed),
        "config": {name: str(v) if isinstance(v, Path) else v for name, v in asdict(config).items()},
        "test_s": took_s,
        "replay_speed": duration_s / (test_s * _REPLAYED),
    }
    metrics |= account(received, folder, base, robots, duration_s)
    if config.localize:
        stage("localizing the undisturbed and the received bag")
        metrics["localization"] = _localization(mission, read_mission(received))
    write_json(folder / "metrics.json", metrics)
    return metrics


def account(
    received: Path, folder: Path, base: Member, robots: list[Member], duration_s: float
) -> dict[str, Any]:
    """Every message a robot recorded, looked for in the bag."""
    in_bag: list[RecordedMessage] = []
    Journal(received, replay=in_bag.append).close()
    numbers = Counter((*sender_of(message), message.sequence) for message in in_bag if sender_of(message)[0])
    per_robot: dict[str, Any] = {}
    for robot in robots:
        spool = Spool(folder / f"{robot.name}.spool", 2**40)
        mine = {
            n for name, incarnation, n in numbers if (name, incarnation) == (robot.name, spool.incarnation)
        }
        waiting, dropped = len(spool), sum(spool.dropped.values())
        # what is neither waiting nor given up nor refused was acknowledged, and must be in the bag
        acknowledged = spool.last_sequence - waiting - dropped - spool.refused
        per_robot[robot.name] = {
            "recorded": spool.last_sequence,
            "acknowledged": acknowledged,
            "waiting": waiting,
            "refused": spool.refused,
            "given_up": dropped,
            "in_bag": len(mine),
            "lost": max(0, acknowledged - len(mine)),
            "copies_sent": sum(f["sent"] for f in robot.figures()),
            "processes": len(robot.processes),
        } | _traffic(robot, duration_s)
        spool.close()
    bases = base.figures()
    names = [robot.name for robot in robots]
    of_pairs = {
        f"{a}-{b}": per_robot[a]["coordination_bytes_per_mission_s"]
        + per_robot[b]["coordination_bytes_per_mission_s"]
        for i, a in enumerate(names)
        for b in names[i + 1 :]
    }
    total = {
        key: sum(robot[key] for robot in per_robot.values())
        for key in (
            "recorded",
            "acknowledged",
            "waiting",
            "refused",
            "given_up",
            "in_bag",
            "lost",
            "copies_sent",
        )
    }
    return {
        "messages": total
        | {
            "duplicated_in_bag": sum(count - 1 for count in numbers.values()),
            "duplicates_turned_away": sum(
                r["outcomes"].get("DUPLICATE", 0) for b in bases for r in b["robots"].values()
            ),
        },
        "robots": per_robot,
        "restarts_survived": {
            "base": len(base.processes) - 1,
            "robots": sum(len(robot.processes) - 1 for robot in robots),
        },
        "peak_memory_mb": {
            "base": max((figures["peak_memory_mb"] for figures in bases), default=0.0),
            "robot": max((f["peak_memory_mb"] for r in robots for f in r.figures()), default=0.0),
        },
        "coordination_bytes_per_mission_s_and_pair": of_pairs,
    }


def _traffic(robot: Member, duration_s: float) -> dict[str, float]:
    """Bytes a second of the mission's own time, copies sent again included."""
    sent = Counter[str]()
    answers = 0
    for figures in robot.figures():
        sent.update(figures["sent_bytes"])
        answers += figures["acknowledgement_bytes"]
    return {
        "coordination_bytes_per_mission_s": (sent["coordination"] + sent["calibration"]) / duration_s,
        "acknowledgement_bytes_per_mission_s": answers / duration_s,
        "radio_bytes_per_mission_s": sent["radio"] / duration_s,
        "image_bytes_per_mission_s": sent["image"] / duration_s,
    }


def _localization(undisturbed: Mission, received: Mission) -> dict[str, Any]:
    """Errors from both bags, and how far the two solutions are apart."""
    solved = {}
    figures: dict[str, Any] = {}
    for name, mission in (("undisturbed", undisturbed), ("received", received)):
        localization = localize(mission, LocalizationConfig(), BearingConfig())
        solved[name] = localization
        found = accuracy(localization, mission) or {}
        figures[name] = {
            "position_rms_m": {robot: f.position_rms_m for robot, f in found.items()},
            "yaw_rms_deg": {robot: f.yaw_rms_deg for robot, f in found.items()},
            "photographs": sum(len(t.time_s) for t in localization.trajectories.values()),
            "bearings": len(localization.bearings),
        }
    figures["largest_difference_m"] = _largest_difference_m(solved)
    return figures


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
