"""Which odometry is sent: keyframes, what surrounds photographs, and all of it while radio is measured."""

from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

from mulan.fleet.wire_topics import Importance

T = TypeVar("T")
_APERTURE_NS = 400_000_000  # of odometry before and after a radio packet: its aperture is found by its motion


@dataclass(frozen=True)
class OdometryConfig:
    """How much dead reckoning is sent."""

    keyframe_s: float = 1.0
    """Between radio measurements one pose in so many seconds is sent; 0 sends all of it."""


class OdometryThinning(Generic[T]):
    """Decides message by message, knowing only the past.

    Poses around photographs are sent so that the pose of a photograph is interpolated between the neighbours
    it was recorded with, and poses around radio packets because they are the aperture.
    """

    def __init__(self, config: OdometryConfig) -> None:
        self._keyframe_ns = int(config.keyframe_s * 1e9)
        self._held: deque[tuple[int, T]] = deque()  # not sent, and may still be wanted
        self._keyframe_at_ns: int | None = None
        self._dense_until_ns = -1
        self._next_wanted = False

    def odometry(self, record_ns: int, message: T) -> list[tuple[int, T, Importance]]:
        """A pose was recorded; what to send now."""
        while self._held and self._held[0][0] < record_ns - _APERTURE_NS:
            self._held.popleft()
        if record_ns <= self._dense_until_ns:
            self._next_wanted = False
            return [(record_ns, message, Importance.RADIO)]
        due = (
            self._keyframe_at_ns is None
            or self._next_wanted
            or record_ns - self._keyframe_at_ns >= self._keyframe_ns
        )
        if not due:
            self._held.append((record_ns, message))
            return []
        if not self._next_wanted:
            self._keyframe_at_ns = record_ns
        self._next_wanted = False
        return [(record_ns, message, Importance.COORDINATION)]

    def photograph(self) -> list[tuple[int, T, Importance]]:
        """A photograph was recorded; the pose before it goes now, the next one when it comes."""
        self._next_wanted = True
        if not self._held:
            return []
        record_ns, message = self._held.pop()
        return [(record_ns, message, Importance.COORDINATION)]

    def packet(self, record_ns: int) -> list[tuple[int, T, Importance]]:
        """A radio packet was recorded; the poses just before it go now, those after it as they come."""
        self._dense_until_ns = max(self._dense_until_ns, record_ns + _APERTURE_NS)
        found = [(t, m, Importance.RADIO) for t, m in self._held if t >= record_ns - _APERTURE_NS]
        self._held.clear()
        return found
