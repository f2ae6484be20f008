import threading
import time

import pytest

from mulan.reconstruction.trainer import TrainingStatus
from mulan.viewer.engine_access import FinishedEngine, TrainingEngine
from tests.planning.analytic_engine import BallEngine


def status_of(engine: BallEngine, step: int, done: float) -> TrainingStatus:
    return TrainingStatus(done, step, 0.002 * step, 100 * step, 27.1, engine)


class Training(threading.Thread):
    """Steps as fast as it may, as a trainer does."""

    def __init__(self, access: TrainingEngine, steps: int = 100_000) -> None:
        super().__init__(daemon=True)
        self.access, self.steps, self.engine = access, steps, BallEngine()
        self.stop = threading.Event()

    def run(self) -> None:
        for step in range(1, self.steps + 1):
            if self.stop.is_set():
                break
            time.sleep(0.001)
            self.access.after_step(status_of(self.engine, step, step / self.steps))
        self.access.end()


def steps_of(training: Training) -> int:
    return training.access.status.steps if training.access.status else 0


@pytest.fixture
def training():
    access = TrainingEngine()
    thread = Training(access)
    thread.start()
    yield thread
    thread.stop.set()
    access.go_on()
    thread.join(timeout=10)


def test_work_is_done_by_the_training_thread_between_steps(training: Training):
    assert training.access.use(lambda engine: (engine, threading.current_thread())) == (
        training.engine,
        training,
    )


def test_a_paused_training_stands_still_and_still_draws(training: Training):
    training.access.use(lambda engine: None)
    training.access.pause()
    training.access.use(lambda engine: None)
    before = steps_of(training)
    time.sleep(0.1)
    assert training.access.use(lambda engine: 7) == 7
    assert steps_of(training) == before
    training.access.one_step()
    until = time.monotonic() + 5
    while steps_of(training) == before and time.monotonic() < until:
        time.sleep(0.005)
    time.sleep(0.1)
    assert steps_of(training) == before + 1
    training.access.go_on()
    time.sleep(0.1)
    assert steps_of(training) > before + 1


def test_an_error_in_the_work_is_its_owner_s_and_training_goes_on(training: Training):
    def broken(engine):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        training.access.use(broken)
    before = steps_of(training)
    time.sleep(0.05)
    assert steps_of(training) > before


def test_work_is_done_after_the_training_s_end(training: Training):
    training.access.use(lambda engine: None)
    training.stop.set()
    training.join(timeout=10)
    assert training.access.use(lambda engine: engine) is training.engine


def test_a_finished_field_can_be_replaced():
    first, second = BallEngine(), BallEngine()
    access = FinishedEngine(first)
    assert access.use(lambda engine: engine) is first
    access.replace(second)
    assert access.use(lambda engine: engine) is second
