import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from mulan.geometry import se3
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.paper_weights import PaperCorrectedWeights, PaperWeights
from mulan.reconstruction.weights import (
    NoWeights,
    UncertaintyWeights,
    local_variance,
    projected_sigma_px,
)

from .cube_scene import cube_images

SPACE = SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded=False)


def with_sigma(image, position_m, angle_rad=0.0):
    covariance = np.diag([angle_rad**2] * 3 + [position_m**2] * 3)
    return replace(image, posed=replace(image.posed, pose_covariance=covariance))


@pytest.fixture
def image(tmp_path):
    return load_captured(cube_images(tmp_path, train=1).train, None)[0]


def test_no_weights_are_one(image):
    assert (NoWeights().weight_map(with_sigma(image, 1.0), SPACE) == 1).all()


def test_paper_weight_is_the_literal_sigmoid_of_the_ellipse_area(image):
    gamma = -2 * math.log(1 - 0.95) * math.pi * 0.3 * 0.3
    weight = PaperWeights().weight_map(with_sigma(image, 0.3), SPACE)
    torch.testing.assert_close(weight, torch.full((24, 24), 1 / (1 + math.exp(-gamma))))


def test_paper_weight_rises_with_uncertainty_from_one_half(image):
    weights = [PaperWeights().weight_map(with_sigma(image, s), SPACE)[0, 0].item() for s in (0.0, 0.1, 0.5)]
    assert weights[0] == 0.5
    assert weights == sorted(weights)
    assert PaperWeights().weight_map(image, SPACE)[0, 0].item() == 0.5


def test_paper_ellipse_takes_the_covariance_to_the_worlds_axes(image):
    # uncertain along the camera's own vertical only; the camera looks almost level
    covariance = np.zeros((6, 6))
    covariance[4, 4] = 1.0
    gamma = PaperWeights().gamma(replace(image, posed=replace(image.posed, pose_covariance=covariance)))
    up = image.T_world_camera[:3, 1]
    assert gamma == pytest.approx(-2 * math.log(0.05) * math.pi * abs(up[0] * up[1]))


def test_corrected_paper_weight_falls_from_one_with_the_area_of_the_ellipse(image):
    weighting = PaperCorrectedWeights(gamma_0_m2=0.1)
    assert weighting.weight_map(image, SPACE)[0, 0].item() == 1
    gamma = -2 * math.log(1 - 0.95) * math.pi * 0.05 * 0.05
    weight = weighting.weight_map(with_sigma(image, 0.05), SPACE)
    torch.testing.assert_close(weight, torch.full((24, 24), 2 / (1 + math.exp(gamma / 0.1))))
    assert weighting.weight_map(with_sigma(image, 3.0), SPACE)[0, 0].item() < 1e-6


@pytest.mark.parametrize("spatial", [False, True])
def test_corrected_ellipse_does_not_depend_on_where_the_world_axes_point(image, spatial):
    covariance = np.diag([0, 0, 0, 0.01, 0.25, 0.04])
    image = replace(image, posed=replace(image.posed, pose_covariance=covariance))
    turn = se3.exp(np.array([0, 0, math.pi / 4, 0, 0, 0]))
    turned = replace(image, posed=replace(image.posed, T_world_camera=turn @ image.T_world_camera))
    corrected = PaperCorrectedWeights(spatial=spatial)
    assert corrected.gamma(turned) == pytest.approx(corrected.gamma(image))
    assert PaperWeights().gamma(turned) != pytest.approx(PaperWeights().gamma(image), rel=0.05)


def test_a_ball_of_uncertainty_has_the_area_of_its_own_disc(image):
    k_squared = 7.814728  # 95 % quantile of chi-squared with three degrees of freedom
    gamma = PaperCorrectedWeights(spatial=True).gamma(with_sigma(image, 0.2))
    assert gamma == pytest.approx(k_squared * math.pi * 0.04)


def test_uncertainty_weights_fall_with_pose_sigma_and_trust_exact_poses_fully(image):
    means = [
        UncertaintyWeights().weight_map(with_sigma(image, s), SPACE).mean().item()
        for s in (0, 0.02, 0.1, 0.5)
    ]
    assert means[0] == 1
    assert means == sorted(means, reverse=True)
    assert means[-1] < 0.5


def test_flat_regions_stay_trusted_and_edges_do_not(image):
    weight = UncertaintyWeights().weight_map(with_sigma(image, 0.1), SPACE)
    assert weight[0, 0] > 0.99
    assert weight.min() < 0.2


def test_weights_below_the_threshold_are_exactly_zero_relative_to_the_best_image(image):
    weighting = UncertaintyWeights(colour_variance=1e-4, threshold=0.01)
    sharp, blurred = weighting.weight_maps([image, with_sigma(image, 0.5)], SPACE)
    assert sharp.mean() == 1
    assert (blurred == 0).any()
    assert ((blurred == 0) | (blurred >= 0.01)).all()


def test_equally_uncertain_images_are_not_all_thrown_away(image):
    maps = UncertaintyWeights(colour_variance=1e-4).weight_maps([with_sigma(image, 0.5)] * 2, SPACE)
    assert max(float(m.max()) for m in maps) == 1


def test_an_image_displaced_too_far_is_ignored_where_others_are_exact(image):
    weighting = UncertaintyWeights(most_sigma_px=3.0)
    near, far = with_sigma(image, 0.05), with_sigma(image, 1.0)
    assert projected_sigma_px(near, SPACE) < 3 < projected_sigma_px(far, SPACE)
    assert weighting.ignored([image, near, far], SPACE) == [False, False, True]
    assert weighting.weight_maps([image, near, far], SPACE)[2].max() == 0


def test_no_image_is_ignored_where_too_few_are_better_known(image):
    near, far = with_sigma(image, 0.05), with_sigma(image, 1.0)
    weighting = UncertaintyWeights(most_sigma_px=3.0, least_within=0.3)
    assert weighting.ignored([near, far, far, far], SPACE) == [False] * 4
    assert weighting.ignored([near, near, far, far], SPACE) == [False, False, True, True]


def test_projected_sigma_matches_monte_carlo(image):
    rng = np.random.default_rng(0)
    L = rng.normal(size=(6, 6)) * 0.01
    image = replace(image, posed=replace(image.posed, pose_covariance=L @ L.T))
    T = image.T_world_camera
    ahead = T[:3, 3] - T[:3, 2] * (T[:3, 3] @ T[:3, 2])  # straight ahead, at the depth of the centre
    noisy = T @ se3.exp(rng.normal(size=(20000, 6)) @ L.T)
    pixels = image.camera.project(se3.transform(se3.inverse(noisy), np.tile(ahead, (20000, 1))))
    assert projected_sigma_px(image, SPACE) == pytest.approx(math.sqrt(pixels.var(0).mean()), rel=0.05)


def test_local_variance_of_a_step_edge_is_a_quarter_at_the_edge():
    picture = np.zeros((9, 40, 3), dtype=np.float32)
    picture[:, 20:] = 1
    variance = local_variance(picture, 2.0)
    assert variance[4, 20] == pytest.approx(0.25, abs=0.02)
    assert variance[4, 2] < 1e-6
