import numpy as np
import pytest

from mulan.viewer.client_pictures import ClientCamera
from mulan.viewer.frame import AbandonedError, pinhole, render_frame
from tests.planning.analytic_engine import BallEngine
from tests.reconstruction.cube_scene import look_at


def frame(quantity, **ball):
    engine = BallEngine(**ball)
    return render_frame(engine, pinhole(64, 36, np.radians(50)), look_at((2.0, 0.0, 0.0)), quantity)


def test_the_ball_hides_what_lies_behind_it_and_nothing_else():
    depth = frame("colour").depth_m
    assert depth[18, 32] == pytest.approx(1.5, abs=0.05)
    assert depth[0, 0] > 100


def test_depth_is_along_the_viewing_axis():
    camera = pinhole(65, 65, np.radians(60))
    depth = render_frame(BallEngine(), camera, look_at((2.0, 0.0, 0.0)), "colour").depth_m
    # a ray that meets the ball at an angle: its distance is longer than the depth a page needs
    row, column = 32, 40
    direction = camera.pixel_directions()[row, column]
    cosine = -direction[2]
    along = 2 * cosine - np.sqrt((2 * cosine) ** 2 - 4 + 0.25)
    assert depth[row, column] == pytest.approx(along * cosine, abs=0.05)


def test_the_uncertain_half_is_the_bright_one():
    # the camera looks along -y at the ball: x > 0 lies to one side
    engine = BallEngine(variance_front=0.04, variance_back=0.01)
    T = look_at((0.0, 2.0, 0.0))
    camera = pinhole(64, 64, np.radians(50))
    shown = render_frame(engine, camera, T, "uncertainty")
    at = T[:3, 3] + 1.5 * (camera.pixel_directions() @ T[:3, :3].T)
    bright = shown.picture.astype(float).sum(-1)
    ball = shown.depth_m < 10
    assert bright[ball & (at[..., 0] > 0.1)].mean() > bright[ball & (at[..., 0] < -0.1)].mean() + 100
    assert "unsure is bright" in shown.legend


def test_depth_of_an_empty_view_is_said_to_be_empty():
    away = look_at((2.0, 0.0, 0.0), (4.0, 0.0, 0.0))
    assert render_frame(BallEngine(), pinhole(8, 8, 1.0), away, "depth").legend == "nothing is seen from here"


def test_a_picture_in_bands_is_the_whole_one_and_one_no_longer_wanted_is_given_up(monkeypatch):
    whole = frame("colour")
    monkeypatch.setattr("mulan.viewer.frame._BAND_RAYS", 1000)
    banded = frame("colour")
    assert np.array_equal(whole.picture, banded.picture)
    assert np.array_equal(whole.depth_m, banded.depth_m)
    answers = iter([True, True, False])
    camera, T = pinhole(64, 36, np.radians(50)), look_at((2.0, 0.0, 0.0))
    with pytest.raises(AbandonedError):
        render_frame(BallEngine(), camera, T, "colour", still_wanted=lambda: next(answers))
    assert next(answers, None) is None, "three bands were begun, no more"


def test_a_picture_has_the_window_s_shape_and_angle():
    view = ClientCamera(np.eye(4), np.radians(60), 1280, 720)
    camera = view.camera(256)
    assert (camera.width, camera.height) == (256, 144)
    assert 2 * np.arctan(camera.height / 2 / camera.fy) == pytest.approx(np.radians(60))
