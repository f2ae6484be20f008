"""One field, several who want it: each waits its turn, whether the field is finished or still learning."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import TypeVar

from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.trainer import TrainingStatus

T = TypeVar("T")


class NoFieldError(RuntimeError):
    """A training ended before its first step."""


class EngineAccess(ABC):
    """Who may use the engine when."""

    @abstractmethod
    def use(self, work: Callable[[RadianceEngine], T]) -> T:
        """Run some work on the engine, alone, and return what it gave."""


class FinishedEngine(EngineAccess):
    """A field nobody trains in this process; it may be replaced by a newer one."""

    def __init__(self, engine: RadianceEngine) -> None:
        self._engine, self._lock = engine, threading.Lock()

    def use(self, work: Callable[[RadianceEngine], T]) -> T:
        """Run the work in the caller's thread, one caller at a time."""
        with self._lock:
            return work(self._engine)

    def replace(self, engine: RadianceEngine) -> None:
        """Show another field from now on."""
        with self._lock:
            self._engine = engine


class TrainingEngine(EngineAccess):
    """A field that learns in another thread, which does the work between two of its steps.

    The page's pause and step buttons act on it.

    Attributes:
        status: How far the training is; None before its first step.
    """

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[Callable[[RadianceEngine], object], Future]] = SimpleQueue()
        self._engine: RadianceEngine | None = None
        self._ended = threading.Event()
        self._may_go_on = threading.Event()
        self._may_go_on.set()
        self._single_steps = threading.Semaphore(0)
        self.status: TrainingStatus | None = None

    @property
    def paused(self) -> bool:
        """Whether training stands still."""
        return not self._may_go_on.is_set()

    def pause(self) -> None:
        """Stand still after the present step."""
        self._may_go_on.clear()

    def go_on(self) -> None:
        """Train again."""
        self._may_go_on.set()

    def one_step(self) -> None:
        """Take one step of a paused training."""
        self._single_steps.release()

    def use(self, work: Callable[[RadianceEngine], T]) -> T:
        """Hand the work to the training thread and wait for it; after the end it is done here.

        Raises:
            NoFieldError: The training ended before its first step.
        """
        future: Future = Future()
        self._waiting.put((work, future))
        if self._ended.is_set():
            self._serve()
        return future.result()

    def after_step(self, status: TrainingStatus) -> None:
        """Do what waits; while paused, go on doing so. Called by the training thread, off its clock."""
        self._engine, self.status = status.engine, status
        self._serve()
        while self.paused and not self._single_steps.acquire(blocking=False):
            self._serve(wait_s=0.02)

    def end(self) -> None:
        """The training thread is done; work is done in the callers' threads from now on."""
        self._ended.set()
        self._serve()

    def _serve(self, wait_s: float = 0.0) -> None:
        while True:
            try:
                work, future = self._waiting.get(block=wait_s > 0, timeout=wait_s or None)
            except Empty:
                return
            wait_s = 0.0
            try:
                if self._engine is None:
                    raise NoFieldError("the first step has not been taken")
                future.set_result(work(self._engine))
            except Exception as error:  # the caller's error, not the training's
                future.set_exception(error)
