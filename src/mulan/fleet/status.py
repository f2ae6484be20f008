"""What a base station or a robot is doing, as JSON for people and for the soak test."""

import resource
import sys
from typing import Any

from mulan.fleet.base_station import BaseStation
from mulan.fleet.replay import Replay
from mulan.fleet.robot_link import RobotLink
from mulan.fleet.ros_robot import RosRobot


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far."""
    try:
        # getrusage would count what the parent had when it forked
        with open("/proc/self/status") as lines:
            return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / 1e3
    except (OSError, StopIteration):
        pass
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def base_status(base: BaseStation) -> dict[str, Any]:
    """Figures of a base station since its process started."""
    robots = {}
    for name, state in sorted(base.ingest.robots.items()):
        clock = base.clocks.get(name)
        robots[name] = {
            "outcomes": dict(state.counts),
            "received_bytes": {i.name.lower(): n for i, n in state.received_bytes.items()},
            "answered_bytes": base.answered_bytes.get(name, 0),
            "clock_offset_s": None if clock is None else clock.offset_ns * 1e-9,
            "clock_bound_s": None if clock is None else clock.bound_ns * 1e-9,
        }
    return {
        "messages_in_bag": base.journal.messages,
        "robots": robots,
        "intrusions": dict(base.ingest.intrusions),
        "inbox_dropped": base.inbox_dropped,
        "disk_problem": base.disk_problem,
        "peak_memory_mb": peak_memory_mb(),
    }


def robot_status(link: RobotLink, source: Replay | RosRobot) -> dict[str, Any]:
    """Figures of a robot since its process started; what concerns the spool, since that was made."""
    counts, clock = link.counts, link.clock.estimate
    return {
        "robot": link.config.name,
        "link": None if link.status is None else link.status.name,
        "recorded": link.spool.last_sequence,
        "waiting": len(link.spool),
        "refused": link.spool.refused,
        "dropped": {i.name.lower(): n for i, n in link.spool.dropped.items()},
        "sent": counts.sent,
        "resent": counts.resent,
        "acknowledged": counts.stored,
        "sent_bytes": {i.name.lower(): n for i, n in counts.sent_bytes.items()},
        "sent_range_bytes": dict(counts.range_bytes),
        "acknowledgement_bytes": counts.received_bytes,
        "bases": counts.bases,
        "clock_offset_s": None if clock is None else clock.offset_ns * 1e-9,
        "clock_bound_s": None if clock is None else clock.bound_ns * 1e-9,
        "replayed": source.done,
        "to_replay": source.total,
        "images": {
            "sent": source.choice.images.sent,
            "recompressed": source.choice.images.recompressed,
            "left_out": source.choice.images.left_out,
        },
        "peak_memory_mb": peak_memory_mb(),
    }
