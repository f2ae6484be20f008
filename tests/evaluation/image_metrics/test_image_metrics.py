import numpy as np
import pytest
import torch

from mulan.errors import InputError
from mulan.evaluation.image_metrics.flip import FlipJudge
from mulan.evaluation.image_metrics.lpips import LpipsJudge
from mulan.evaluation.image_metrics.variance_calibration import VarianceJudge, ause, coverage
from mulan.radiance.engine import Rendering
from mulan.reconstruction.captured_image import load_captured

from ...reconstruction.cube_scene import cube_images

RNG = np.random.default_rng(0)


def rendering(colour, variance=0.01):
    rays = colour.reshape(-1, 3).shape[0]
    flat = torch.from_numpy(np.ascontiguousarray(colour.reshape(-1, 3))).float()
    return Rendering(flat, torch.ones(rays), torch.ones(rays), torch.full((rays,), variance))


@pytest.fixture
def image(tmp_path):
    return load_captured(cube_images(tmp_path, train=1, test=0, side=48).train, None)[0]


def test_a_variance_that_ranks_like_the_error_has_no_sparsification_error():
    error = RNG.exponential(size=1000)
    assert ause(error, error**2) == pytest.approx(0, abs=1e-12)
    random = ause(error, RNG.random(1000))
    assert 0.2 < random < ause(error, -error)


def test_sparsification_error_does_not_depend_on_the_scale_of_the_error():
    error, variance = RNG.exponential(size=500), RNG.random(500)
    assert ause(100 * error, variance) == pytest.approx(ause(error, variance))
    assert ause(np.zeros(5), np.ones(5)) == 0


@pytest.mark.parametrize(("factor", "expected"), [(1.0, 0.95), (4.0, 0.9999), (0.25, 0.673)])
def test_coverage_is_95_per_cent_where_the_variance_is_that_of_the_error(factor, expected):
    variance = RNG.uniform(0.01, 0.1, 20000)
    error = RNG.normal(size=(20000, 3)) * np.sqrt(variance)[:, None]
    assert coverage(error, variance * factor) == pytest.approx(expected, abs=0.01)


def test_the_white_background_does_not_count(image):
    colour = image.colour_fraction.copy()
    colour[image.alpha == 0] = 0.0  # wrong only where the object is not
    figures = VarianceJudge()(rendering(colour), image)
    assert figures == {"ause": 0.0, "coverage_95": 1.0}


def test_what_is_not_installed_is_not_available_and_says_why(image, monkeypatch):
    monkeypatch.setattr("mulan.evaluation.image_metrics.flip.find_spec", lambda name: None)
    monkeypatch.setattr("mulan.evaluation.image_metrics.lpips.find_spec", lambda name: None)
    flip, lpips = FlipJudge(), LpipsJudge()
    assert flip(rendering(image.colour_fraction), image) == {"flip": None}
    assert lpips(rendering(image.colour_fraction), image) == {"lpips": None}
    assert flip.why_not == "flip-evaluator is not installed"
    assert lpips.why_not == "torchvision is not installed"


def test_missing_weights_of_lpips_are_named(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        LpipsJudge(tmp_path / "alexnet.pth")


def test_flip_is_zero_for_equal_pictures_and_grows_with_the_difference(image):
    pytest.importorskip("flip_evaluator")
    judge = FlipJudge()
    true = image.colour_fraction
    distances = np.array([judge(rendering(true * scale), image)["flip"] for scale in (1.0, 0.9, 0.5)], float)
    assert distances[0] == pytest.approx(0, abs=1e-6)
    assert (np.diff(distances) > 0).all()
    assert distances[-1] < 1
