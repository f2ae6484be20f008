"""How far two clocks are apart, from messages that went there and back (RFC 5905, section 8)."""

from collections import deque
from dataclasses import dataclass

_KEPT = 64


@dataclass(frozen=True)
class ClockOffset:
    """The base station's clock minus the robot's.

    Attributes:
        offset_ns: Best estimate.
        bound_ns: It cannot be wrong by more, whatever the delays each way were.
    """

    offset_ns: int
    bound_ns: int


class ClockEstimator:
    """Keeps the last exchanges and believes the one with the shortest way there and back."""

    def __init__(self) -> None:
        self._exchanges: deque[tuple[int, int]] = deque(maxlen=_KEPT)

    def add(self, sent_ns: int, received_ns: int, answered_ns: int, returned_ns: int) -> None:
        """One exchange; the first and last stamp are the robot's, the others the base station's."""
        delay_ns = (returned_ns - sent_ns) - (answered_ns - received_ns)
        if delay_ns < 0:
            self._exchanges.clear()  # a clock was set in between: nothing before counts
            return
        offset_ns = ((received_ns - sent_ns) + (answered_ns - returned_ns)) // 2
        if self._exchanges and abs(offset_ns - self._exchanges[-1][1]) > delay_ns + self._exchanges[-1][0]:
            self._exchanges.clear()
        self._exchanges.append((delay_ns, offset_ns))

    @property
    def estimate(self) -> ClockOffset | None:
        """None before the first exchange."""
        if not self._exchanges:
            return None
        delay_ns, offset_ns = min(self._exchanges)
        return ClockOffset(offset_ns, delay_ns // 2 + 1)
