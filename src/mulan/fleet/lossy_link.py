"""A bad radio link in software: drops, delays, duplicates and reorders, by seed."""

import heapq
import itertools
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")


@dataclass(frozen=True)
class LossConfig:
    """How bad the link is, each way; for tests and trials."""

    loss: float = 0.0
    """Probability that a message is lost."""
    duplicate: float = 0.0
    """Probability that it comes twice."""
    delay_s: float = 0.0
    """Shortest delay."""
    jitter_s: float = 0.0
    """Random delay added, uniform up to this; messages overtake each other."""
    seed: int = 0
    """Source of the randomness."""

    @property
    def perfect(self) -> bool:
        """Whether nothing happens to any message."""
        return not (self.loss or self.duplicate or self.delay_s or self.jitter_s)


class LossyLink(Generic[T]):
    """One direction of a bad link.

    Attributes:
        lost, duplicated: How many messages were.
    """

    def __init__(self, config: LossConfig, deliver: Callable[[T], object], direction: int) -> None:
        """Start it.

        Args:
            config: How bad it is.
            deliver: Called, by the link's own thread, with what comes through.
            direction: Makes the two directions of one link differ.
        """
        self.lost = 0
        self.duplicated = 0
        self._config, self._deliver = config, deliver
        self._rng = np.random.default_rng([config.seed, direction])
        self._waiting: list[tuple[float, int, T]] = []
        self._order = itertools.count()
        self._changed = threading.Condition()
        self._closed = False
        self._thread: threading.Thread | None = None
        if not config.perfect:
            self._thread = threading.Thread(target=self._work, name="lossy link", daemon=True)
            self._thread.start()

    def send(self, item: T) -> None:
        """Put something on the link."""
        if self._thread is None:
            self._deliver(item)
            return
        with self._changed:
            copies = 1
            if self._rng.random() < self._config.loss:
                copies, self.lost = 0, self.lost + 1
            elif self._rng.random() < self._config.duplicate:
                copies, self.duplicated = 2, self.duplicated + 1
            for _ in range(copies):
                delay_s = self._config.delay_s + self._config.jitter_s * self._rng.random()
                heapq.heappush(self._waiting, (time.monotonic() + delay_s, next(self._order), item))
            self._changed.notify()

    def close(self) -> None:
        """Stop; what is on its way is lost."""
        if self._thread is None:
            return
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._closed and (not self._waiting or self._waiting[0][0] > time.monotonic()):
                    until = self._waiting[0][0] - time.monotonic() if self._waiting else None
                    self._changed.wait(until)
                if self._closed:
                    return
                item = heapq.heappop(self._waiting)[2]
            self._deliver(item)
