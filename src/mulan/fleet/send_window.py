"""Which waiting messages are under way to the base station, and when each is sent again."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mulan.fleet.spool import Spool, Spooled
from mulan.fleet.token_bucket import TokenBucket
from mulan.fleet.wire_topics import Importance

_FEWEST = 64  # messages always allowed under way
_SPARE = 64  # more of those that come first
_PROMPT_S = 0.5  # an answer may wait this long for others at the base station
_ANSWER_EVERY_S = 0.2  # of the base station
_REMEMBERED = 64  # messages whose attempts count
_MOST_ANSWERS = 12.0  # that one which came may stand for


@dataclass(frozen=True)
class WindowConfig:
    """How much is under way at once, and when it is sent again."""

    messages: int = 1024
    """Most messages under way."""
    megabytes: float = 4.0
    """Most of their payload under way."""
    first_wait_s: float = 0.5
    """Time to wait for an answer before sending again, until round trips have been measured."""
    longest_wait_s: float = 20.0
    """This wait doubles at every attempt up to here while nothing is heard."""
    longest_wait_heard_s: float = 2.0
    """And only up to here while answers come; and it doubles only every so many attempts as messages take on
    average, so that over a link that loses nearly everything it hardly grows."""
    heard_for_s: float = 60.0
    """An answer tells for so long that the link is there."""
    again_per_s: float = 400.0
    """Most messages sent again a second."""
    kilobytes_per_s: float = 4000.0
    """What the link is believed to carry."""
    image_kilobytes_per_s: float = 2000.0
    """Of this, at most so much for images."""


@dataclass
class _UnderWay:
    message: Spooled
    attempts: int
    due_s: float


class SendWindow:
    """Takes the most important messages from the spool first; images keep to their own rate."""

    def __init__(self, config: WindowConfig, spool: Spool) -> None:
        self.config = config
        self._spool = spool
        self._under_way: dict[int, _UnderWay] = {}
        self._bytes = 0
        self._taken_to = dict.fromkeys(Importance, 0)
        self._allowed = float(_FEWEST)
        self._widened_s, self._narrowed_s = time.monotonic(), float("-inf")
        self._shortest_s = float("inf")
        self._heard_s = float("-inf")
        self._copies = self._settled = 1.0  # of late
        self._round_trip_s: float | None = None
        self._spread_s = 0.0
        self._rng = np.random.default_rng()
        rate, images = config.kilobytes_per_s * 1e3, config.image_kilobytes_per_s * 1e3
        self._again_rate = TokenBucket(config.again_per_s, config.again_per_s)
        self._rate = TokenBucket(rate, rate * 0.5)
        self._image_rate = TokenBucket(images, images * 0.5)

    def __len__(self) -> int:
        return len(self._under_way)

    @property
    def allowed(self) -> int:
        """Messages that may be under way now."""
        return int(self._allowed)

    @property
    def wait_s(self) -> float:
        """Time an answer is given to come: RFC 6298, and as long as an answer waits for others."""
        if self._round_trip_s is None:
            return self.config.first_wait_s
        waited_s = self._round_trip_s + 4 * self._spread_s + _ANSWER_EVERY_S
        return float(np.clip(waited_s, 0.1, self.config.longest_wait_s))

    def heard(self, now_s: float) -> None:
        """Take note that an answer came."""
        self._heard_s = now_s

    def round_trip(self, measured_s: float) -> None:
        """Take note of how long an answer took."""
        if self._round_trip_s is None:
            self._round_trip_s, self._spread_s = measured_s, measured_s / 2
            return
        self._adjust(measured_s)
        self._spread_s += (abs(measured_s - self._round_trip_s) - self._spread_s) / 4
        self._round_trip_s += (measured_s - self._round_trip_s) / 8

    def _adjust(self, measured_s: float) -> None:
        """Widen the window while answers come promptly, narrow it when they queue up.

        Loss says nothing on a radio link; growing delay shows that the link or the base station is behind.
        """
        now_s = time.monotonic()
        self._shortest_s = min(self._shortest_s * 1.001, measured_s)
        if measured_s < _PROMPT_S + 3 * self._shortest_s:
            # a lost answer would have widened it too
            answers = np.clip((now_s - self._widened_s) / _ANSWER_EVERY_S, 1.0, _MOST_ANSWERS)
            self._allowed = min(self._allowed * 1.1 ** float(answers) + 1, float(self.config.messages))
            self._widened_s = now_s
        elif now_s - self._narrowed_s > measured_s:
            self._allowed = max(self._allowed * 0.6, float(_FEWEST))
            self._narrowed_s = now_s

    def due(self, now_s: float) -> list[tuple[Spooled, bool]]:
        """What to send now, and whether it was sent before."""
        found: list[tuple[Spooled, bool]] = []
        heard = now_s - self._heard_s < self.config.heard_for_s
        longest_s = self.config.longest_wait_s
        if heard:
            longest_s = min(longest_s, max(self.config.longest_wait_heard_s, self.wait_s))
        overdue = [u for u in self._under_way.values() if u.due_s <= now_s]
        for under_way in sorted(overdue, key=lambda u: (u.message.importance, u.message.sequence)):
            if self._again_rate.available(now_s) < 1 or not self._may_send(under_way.message, now_s):
                break
            self._again_rate.take(1, now_s)
            usual = max(1.0, self._copies / self._settled) if heard else 1.0
            wait_s = min(self.wait_s * 2.0 ** min(under_way.attempts / usual, 16.0), longest_s)
            self._copies += 1
            under_way.attempts += 1
            under_way.due_s = now_s + wait_s * float(self._rng.uniform(0.9, 1.1))
            found.append((under_way.message, True))
        for importance in Importance:
            self._start(importance, now_s, found)
        return found

    def pause_s(self, now_s: float) -> float:
        """How long nothing needs to be sent, unless something new comes."""
        earliest_s = min((u.due_s for u in self._under_way.values()), default=now_s + 0.25)
        return float(np.clip(earliest_s - now_s, 0.005, 0.25))

    def settle(self, through: int, beyond: Sequence[tuple[int, int]], refused: Iterable[int]) -> None:
        """Let go of what the base station has."""
        refused = set(refused)
        for sequence in [
            n
            for n in self._under_way
            if n <= through or n in refused or any(first <= n <= last for first, last in beyond)
        ]:
            self._bytes -= len(self._under_way.pop(sequence).message.payload)
            kept = 1 - 1 / _REMEMBERED
            self._copies, self._settled = kept * self._copies, kept * self._settled + 1

    def hurry(self) -> None:
        """The link is back: send everything under way again, without waiting."""
        for under_way in self._under_way.values():
            under_way.attempts, under_way.due_s = 0, 0.0

    def _start(self, importance: Importance, now_s: float, found: list[tuple[Spooled, bool]]) -> None:
        while True:
            # what waits for a lossy link's answers must not keep out what localization cannot do without
            spare = _SPARE if importance <= Importance.COORDINATION else 0
            room = self.allowed + spare - len(self._under_way)
            if room <= 0 or self._bytes >= self.config.megabytes * 1e6:
                return
            taken = self._spool.next_of(importance, self._taken_to[importance], min(room, 32))
            for message in taken:
                if self._bytes >= self.config.megabytes * 1e6 or not self._may_send(message, now_s):
                    return
                self._taken_to[importance] = message.sequence
                self._under_way[message.sequence] = _UnderWay(message, 1, now_s + self.wait_s)
                self._bytes += len(message.payload)
                self._copies += 1
                found.append((message, False))
            if not taken:
                return

    def _may_send(self, message: Spooled, now_s: float) -> bool:
        size = len(message.payload) + 150  # key and attachment
        if message.importance is Importance.IMAGE:
            if self._rate.available(now_s) < min(size, self._rate.capacity):
                return False
            return self._image_rate.take(size, now_s) and self._rate.take(size, now_s)
        return self._rate.take(size, now_s)
