"""How late messages arrived, how many a second, and how long the base station could sustain it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.fleet.journal import sender_of
from mulan.fleet.journal_scan import RecordedMessage
from mulan.fleet.wire_topics import WIRE_TOPICS, Importance

_NS_PER_S = 1_000_000_000
_SUSTAINED_S = 10  # a rate kept for less is a burst


@dataclass(frozen=True)
class ReplayedTime:
    """When a robot that replays a bag recorded a message, on this machine's clock.

    Attributes:
        started_ns: When it began.
        bag_start_ns: First stamp of the bag.
        speed: Times real time.
    """

    started_ns: int
    bag_start_ns: int
    speed: float

    def recorded_s(self, record_ns: int) -> float:
        """Seconds since the epoch."""
        return (self.started_ns + (record_ns - self.bag_start_ns) / self.speed) / _NS_PER_S


@dataclass(frozen=True)
class Arrivals:
    """Every robot's message in the bag.

    Attributes:
        arrived_s: When it came, seconds since the first one did.
        lag_s: How long after it was recorded that was; what waited for its robot to be alive again counts.
        importance: Of each.
    """

    arrived_s: Float[NDArray, "n"]
    lag_s: Float[NDArray, "n"]
    importance: NDArray[np.int64]

    def figures(self) -> dict[str, Any]:
        """Lag by importance, and messages a second: mean, busiest ten seconds, busiest second."""
        if not len(self.arrived_s):
            return {"lag_s": {}, "messages_per_s": {}}
        lag = {}
        for importance in Importance:
            of = self.lag_s[self.importance == importance]
            if len(of):
                quantiles = np.quantile(of, (0.5, 0.95, 1.0))
                lag[importance.name.lower()] = dict(
                    zip(("median", "p95", "largest"), map(float, quantiles), strict=True)
                )
        a_second = np.bincount(self.arrived_s.astype(int))
        window = np.ones(min(_SUSTAINED_S, len(a_second)))
        sustained = np.convolve(a_second, window, "valid") / len(window)
        return {
            "lag_s": lag,
            "messages_per_s": {
                "mean": float(len(self.arrived_s) / max(self.arrived_s.max(), 1.0)),
                f"busiest_{_SUSTAINED_S}_s": float(sustained.max()),
                "busiest_second": int(a_second.max()),
            },
        }


def arrivals(in_bag: Sequence[RecordedMessage], clocks: Mapping[str, ReplayedTime]) -> Arrivals:
    """Of the robots' own recordings; what the link itself adds (the clock's offset) is left out."""
    rows = []
    for message in in_bag:
        robot, _ = sender_of(message)
        topic = message.channel.topic
        suffix = topic.removeprefix(f"/{robot}/").removeprefix("/")
        if robot not in clocks or suffix == "clock":
            continue
        recorded_s = clocks[robot].recorded_s(message.record_ns)
        rows.append((message.log_ns / _NS_PER_S, recorded_s, int(WIRE_TOPICS[suffix].importance)))
    found = np.array(rows, dtype=float).reshape(-1, 3)
    began_s = found[:, 0].min() if len(found) else 0.0
    # the journal keeps its order of time, so a clock set back shows as a lag, never as a negative one
    lag_s = np.maximum(found[:, 0] - found[:, 1], 0.0)
    return Arrivals(found[:, 0] - began_s, lag_s, found[:, 2].astype(np.int64))
