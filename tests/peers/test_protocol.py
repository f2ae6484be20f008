import json
from importlib import import_module

import numpy as np
import pytest

protocol = import_module("protocol")
scene = import_module("scene")


class Peer:
    """Renders white at once, so its score is known; counts what it is asked."""

    name, version, steps = "white", "1", 0

    def step(self):
        self.steps += 1
        return 100, 400

    def render(self, view):
        return np.ones_like(view.rgb)

    def notes(self):
        return {"rays_per_step": 100}


def a_view(grey):
    return scene.View(np.full((4, 4, 3), grey), np.ones((4, 4, 1)), np.eye(4))


@pytest.fixture
def options(tmp_path):
    common = ["--data", str(tmp_path), "--out", str(tmp_path / "out.json"), "--eval-every-nth-view", "2"]
    return protocol.parser("a peer").parse_args([*common, "--budget-s", "0.05", "--first-eval-s", "0.01"])


def test_the_score_is_the_mean_psnr_over_the_views_named(options):
    camera = scene.Camera(4, 4, 4.0, 4.0, 2.0, 2.0, (0.0, 0.0, 0.0, 0.0))
    views = [a_view(0.9), a_view(0.0), a_view(0.99)]
    result = protocol.measure(Peer(), scene.Scene("s", camera, views, views, True), options)
    assert result.psnr_curve[-1][1] == pytest.approx((20 + 40) / 2, abs=1e-3)
    assert result.notes["views_scored"] == 2
    assert result.psnr_curve[-1][0] >= 0.05
    assert result.samples_per_s == pytest.approx(4 * result.rays_per_s)


def test_time_to_a_target_is_linear_between_evaluations_and_null_when_never_reached():
    assert protocol.seconds_to([(10, 20.0), (20, 30.0)], 28.0) == pytest.approx(18.0)
    assert protocol.seconds_to([(10, 29.0)], 28.0) == 10
    assert protocol.seconds_to([(10, 20.0)], 28.0) is None


def test_the_file_says_the_time_to_28_db(options):
    result = protocol.Result("a", "1", psnr_curve=[(1.0, 27.0), (2.0, 29.0)])
    result.finish(options.out)
    assert json.loads(options.out.read_text())["seconds_to_28_db"] == pytest.approx(1.5)


def test_the_clock_stands_still_outside_its_block():
    clock = protocol.TrainingClock("wall", 1)
    with clock:
        pass
    before = clock.seconds
    sum(range(10_000))
    assert clock.seconds == before
