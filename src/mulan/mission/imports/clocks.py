"""Whether a bag's stamps can be what they claim: header stamps against recording times, robot by robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mulan.errors import InputError
from mulan.mission.imports.topic_map import ForeignTopic, RobotTopics

MOST_APART_S = 1.0  # between topics of one robot; transport and exposure take less


@dataclass
class StampLog:
    """Stamps of one topic as they come.

    Attributes:
        header_s: In the messages' headers.
        record_s: When they were recorded.
    """

    header_s: list[float] = field(default_factory=list)
    record_s: list[float] = field(default_factory=list)

    def add(self, header_s: float, record_s: float) -> None:
        """Note one message."""
        self.header_s.append(header_s)
        self.record_s.append(record_s)

    @property
    def lag_s(self) -> float:
        """Median of recording time minus header stamp."""
        return float(np.median(np.array(self.record_s) - np.array(self.header_s)))


def check_robot(bag: str, robot: RobotTopics, logs: Mapping[ForeignTopic, StampLog]) -> None:
    """See that one robot's topics share a clock.

    Raises:
        InputError: Header stamps do not advance, or lag behind recording by different times in two topics, so
            that they are of different clocks.
    """
    lags = {}
    for topic, log in logs.items():
        if topic.clock == "record" or len(log.header_s) < 2:
            continue
        if max(log.header_s) <= min(log.header_s) and max(log.record_s) > min(log.record_s):
            raise InputError(
                bag,
                f"topic {topic.name}",
                f"every header has the stamp {log.header_s[0]:.3f} s",
                f"set clock = {{ {topic.role.key} = 'record' }} for robot {robot.name}, or record it again",
            )
        lags[topic] = log.lag_s
    if not lags:
        return
    first, last = min(lags, key=lags.__getitem__), max(lags, key=lags.__getitem__)
    apart_s = lags[last] - lags[first]
    if apart_s > MOST_APART_S:
        raise InputError(
            bag,
            f"topics {first.name} and {last.name}",
            f"clocks apart: their header stamps lie {lags[first]:.2f} s and {lags[last]:.2f} s before the"
            f" times they were recorded at, {apart_s:.2f} s from each other",
            f"set clock = 'record' for robot {robot.name}, or for the topic whose stamps are wrong",
        )


def check_photos_within(
    bag: str, name: str, photo_s: Sequence[float], odometry_s: Sequence[float]
) -> str | None:
    """A remark on photographs outside the odometry's time, None if there are none.

    Raises:
        InputError: All are outside.
    """
    times = np.array(photo_s)
    outside = (times < min(odometry_s)) | (times > max(odometry_s))
    if outside.all():
        raise InputError(
            bag,
            f"robot {name}",
            f"clocks apart: no photograph ({min(photo_s):.2f} to {max(photo_s):.2f} s) lies within its"
            f" odometry ({min(odometry_s):.2f} to {max(odometry_s):.2f} s)",
            "set clock = 'record', or name the topics of one recording",
        )
    if outside.any():
        return f"{name}: {int(outside.sum())} of {len(times)} photographs lie outside its odometry's time"
    return None


def remarks_between(spans_s: Mapping[str, tuple[float, float]]) -> list[str]:
    """Pairs of robots whose recordings share no instant.

    Args:
        spans_s: First and last recording time of each robot.
    """
    names = list(spans_s)
    return [
        f"{a} and {b} were never recorded at the same time ({spans_s[a][0]:.1f} to {spans_s[a][1]:.1f} s and"
        f" {spans_s[b][0]:.1f} to {spans_s[b][1]:.1f} s on the recorders' clocks): no radio can connect them"
        for i, a in enumerate(names)
        for b in names[i + 1 :]
        if spans_s[a][1] < spans_s[b][0] or spans_s[b][1] < spans_s[a][0]
    ]
