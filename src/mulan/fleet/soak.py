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
from mulan.fleet.replay import REPLAY_STARTED
from mulan.fleet.soak_arrivals import ReplayedTime, arrivals
from mulan.fleet.soak_localization import as_it_arrived, compared
from mulan.fleet.soak_picture import draw_lag
from mulan.fleet.soak_processes import (
    Kill,
    Member,
    MemoryWatch,
    base_member,
    free_endpoint,
    robot_member,
    start_all,
    watch,
)
from mulan.fleet.spool import Spool
from mulan.mission.bag_reader import read_mission, robots_of
from mulan.mission.run_folder import write_json

_REAL_TIME = 0.03  # a replay so near to real time is one


@dataclass(frozen=True)
class SoakConfig:
    """A base station and the robots of a bag, with faults."""

    bag: Path
    """Mission the robots replay."""
    out: Path
    """Folder to write; metrics.json lies in it."""
    minutes: float = 3.0
    """How long."""
    recorded_share: float = 0.85
    """The bag is replayed in this share of it, slower or faster than it was recorded; what was missed is sent
    in the rest."""
    loss: float = 0.2
    """Messages lost, each way."""
    jitter_s: float = 0.2
    """Random delay, each way, up to this."""
    duplicate: float = 0.02
    """Messages that come twice."""
    robot_away_s: float = 300.0
    """The second robot is killed for this long, or a sixth of the test if that is shorter; 0 leaves it be."""
    base_kills: int = 2
    """How often the base station is killed."""
    localize: bool = True
    """Localize from the received bag and from the undisturbed one, and compare."""
    instants: int = 0
    """Localize also from what had come by so many instants, evenly spread."""
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
    names = tuple(robots_of(config.bag))
    if len(names) < 2:
        raise InputError(config.bag, "robots", "are fewer than two", "simulate a mission with two or more")
    folder, received = config.out, config.out / "mission.mcap"
    if received.exists():
        raise InputError(folder, "folder", "holds an earlier test", "choose another --out")
    folder.mkdir(parents=True, exist_ok=True)
    with Reader(config.bag) as reader:
        duration_s, bag_start_ns = reader.duration * 1e-9, reader.start_time
    test_s = config.minutes * 60
    speed = duration_s / (test_s * config.recorded_share)
    speed = 1.0 if abs(speed - 1) < _REAL_TIME else speed
    endpoint = free_endpoint()
    base = base_member(folder, received, endpoint, names)
    robots = [
        robot_member(
            folder,
            name,
            config.bag,
            speed,
            endpoint,
            LossConfig(config.loss, config.duplicate, 0.002, config.jitter_s, config.seed + index),
        )
        for index, name in enumerate(names)
    ]
    away_s = min(config.robot_away_s, test_s / 6)
    kills = [Kill(robots[1], 0.15 * test_s, 0.15 * test_s + away_s)] if away_s else []
    recorded_s = test_s * config.recorded_share
    for at_s in np.linspace(0.45, 0.8, config.base_kills) * recorded_s:
        kills.append(Kill(base, float(at_s), float(at_s) + min(10.0, test_s / 30), 0.1 * recorded_s))
    stage(f"{len(names)} robots for {config.minutes:g} min")
    members = [base, *robots]
    memory = MemoryWatch(members)
    try:
        start_all(members, 300)
        took_s = watch(members, kills, 3 * test_s + 300, memory.sample, test_s)
    finally:
        for member in reversed(members):
            member.stop(20)
    for member in members:
        if member.failed:
            raise InputError(folder, member.name, f"failed ({member.said()})", "see its .log files")
    metrics = {
        "provenance": provenance(config.seed),
        "config": {name: v.name if isinstance(v, Path) else v for name, v in asdict(config).items()},
        "test_s": took_s,
        "replay_speed": speed,
    }
    in_bag: list[RecordedMessage] = []
    Journal(received, replay=in_bag.append).close()
    metrics |= account(in_bag, folder, base, robots, duration_s)
    metrics["memory_mb_by_minute"] = memory.by_minute
    arrived = arrivals(in_bag, _clocks(folder, robots, bag_start_ns, speed))
    metrics |= arrived.figures()
    draw_lag(arrived, members, folder / "lag.png")
    write_json(folder / "metrics.json", metrics)
    if config.localize:
        stage("localizing the undisturbed and the received bag")
        metrics["localization"] = compared(read_mission(config.bag), read_mission(received))
    if config.instants:
        stage("localizing from what had come by some instants")
        metrics["as_it_arrived"] = as_it_arrived(received, config.instants, folder)
    write_json(folder / "metrics.json", metrics)
    return metrics


def _clocks(folder: Path, robots: list[Member], bag_start_ns: int, speed: float) -> dict[str, ReplayedTime]:
    clocks = {}
    for robot in robots:
        spool = Spool(folder / f"{robot.name}.spool", 2**40)
        started_ns = spool.noted(REPLAY_STARTED)
        spool.close()
        if started_ns is not None:
            clocks[robot.name] = ReplayedTime(started_ns, bag_start_ns, speed)
    return clocks


def account(
    in_bag: list[RecordedMessage], folder: Path, base: Member, robots: list[Member], duration_s: float
) -> dict[str, Any]:
    """Every message a robot recorded, looked for in the bag."""
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
        f"{a}-{b}": _coordination(per_robot[a], b) + _coordination(per_robot[b], a)
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


def _coordination(robot: Mapping[str, Any], peer: str) -> float:
    """What a robot sends for one pair: odometry, which is for all, and ranges to this peer."""
    ranges = robot["range_bytes_per_mission_s"]
    return robot["coordination_bytes_per_mission_s"] - sum(ranges.values()) + ranges.get(peer, 0.0)


def _traffic(robot: Member, duration_s: float) -> dict[str, Any]:
    """Bytes a second of the mission's own time, copies sent again included."""
    sent, ranges = Counter[str](), Counter[str]()
    answers = 0
    for figures in robot.figures():
        sent.update(figures["sent_bytes"])
        ranges.update(figures["sent_range_bytes"])
        answers += figures["acknowledgement_bytes"]
    return {
        "coordination_bytes_per_mission_s": (sent["coordination"] + sent["calibration"]) / duration_s,
        "range_bytes_per_mission_s": {peer: count / duration_s for peer, count in ranges.items()},
        "acknowledgement_bytes_per_mission_s": answers / duration_s,
        "radio_bytes_per_mission_s": sent["radio"] / duration_s,
        "image_bytes_per_mission_s": sent["image"] / duration_s,
    }
