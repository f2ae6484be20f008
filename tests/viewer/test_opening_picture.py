import time

import numpy as np
import pytest

from mulan.viewer.client_pictures import ClientCamera
from mulan.viewer.engine_access import FinishedEngine, NoFieldError, TrainingEngine
from mulan.viewer.opening_picture import OpeningPicture
from tests.planning.analytic_engine import BallEngine
from tests.reconstruction.cube_scene import look_at

VIEW = ClientCamera(look_at((2.0, 0.0, 0.0)), np.radians(50), 64, 36)


class Opening:
    """An opening picture and all that was sent of it."""

    def __init__(self, engine, somebody_looks: bool = False, period_s: float | None = None) -> None:
        self.pictures: list[np.ndarray] = []
        self.somebody_looks = somebody_looks
        self.picture = OpeningPicture(
            self.pictures.append, engine, VIEW, 64, lambda: self.somebody_looks, period_s
        )

    def wait_for(self, pictures: int) -> None:
        until = time.monotonic() + 10
        while len(self.pictures) < pictures:
            assert time.monotonic() < until
            time.sleep(0.01)


def test_the_first_view_is_ready_before_anybody_comes():
    opening = Opening(FinishedEngine(BallEngine()))
    opening.wait_for(1)
    opening.picture.stop()
    assert opening.pictures[0].shape == (36, 64, 3)
    assert opening.pictures[0].std() > 5


def test_nobody_s_own_picture_is_replaced():
    opening = Opening(FinishedEngine(BallEngine()), somebody_looks=True)
    time.sleep(0.1)
    assert not opening.pictures
    opening.somebody_looks = False
    opening.picture.redraw()
    opening.wait_for(1)
    opening.picture.stop()


def test_a_field_that_learns_is_drawn_again():
    opening = Opening(FinishedEngine(BallEngine()), period_s=0.02)
    opening.wait_for(3)
    opening.picture.stop()


@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_training_that_fails_at_once_has_no_first_view():
    access = TrainingEngine()
    opening = Opening(access)
    access.end()
    opening.picture.stop()
    assert not opening.pictures
    with pytest.raises(NoFieldError):
        access.use(lambda engine: engine)
