import numpy as np
import pytest
import torch
from torch.testing import assert_close

from mulan.geometry import se3
from mulan.planning.pose_growth import DriftConfig, covariance_after_move
from mulan.planning.rays import camera_rays
from mulan.planning.score import (
    CandidateView,
    LiteralPosterior,
    PropagatedPosterior,
    pose_colour_variance,
    posterior_variance,
    ray_variance,
    variance_reduction,
)
from mulan.radiance.engine import RaySamples

from .analytic_engine import BallEngine

EXACT = np.zeros((6, 6))


def position_covariance(sigma_m: float):
    return np.diag([0.0, 0.0, 0.0, sigma_m**2, sigma_m**2, sigma_m**2])


def test_posterior_is_the_gaussian_update_of_a_linear_measurement():
    blend, prior, noise = torch.tensor([0.7]), torch.tensor([0.04]), torch.tensor([0.02])
    samples = RaySamples(torch.tensor([0]), blend, torch.rand(1, 3), prior, torch.ones(1))
    kalman = prior - (prior * blend) ** 2 / (blend**2 * prior + noise)
    assert_close(posterior_variance(samples, noise), kalman)


def test_ray_variance_sums_blend_squared_times_variance_ray_by_ray():
    samples = RaySamples(
        torch.tensor([0, 0, 2]),
        torch.tensor([0.5, 0.2, 1.0]),
        torch.zeros(3, 3),
        torch.tensor([0.1, 0.2, 0.3]),
        torch.ones(3),
    )
    assert_close(ray_variance(samples, 3), torch.tensor([0.025 + 0.008, 0.0, 0.3]))


@pytest.mark.parametrize("posterior", [PropagatedPosterior(), LiteralPosterior()])
def test_score_falls_as_the_pose_gets_worse(posterior, camera, T_world_camera):
    scores = [
        variance_reduction(
            BallEngine(), CandidateView(camera, T_world_camera, position_covariance(s), 32), posterior
        )
        for s in (0.0, 0.02, 0.05, 0.1)
    ]
    assert scores[0] > 0
    assert scores == sorted(scores, reverse=True)
    assert scores[-1] < 0.8 * scores[0]


def test_the_two_forms_agree_for_an_exact_pose(camera, T_world_camera):
    view = CandidateView(camera, T_world_camera, EXACT, 32)
    propagated = variance_reduction(BallEngine(), view, PropagatedPosterior())
    assert propagated == pytest.approx(variance_reduction(BallEngine(), view, LiteralPosterior()), rel=1e-5)


def test_pose_uncertainty_costs_nothing_where_the_image_is_plain_except_in_the_literal_form(
    camera, T_world_camera
):
    close = T_world_camera.copy()
    close[:3, 3] = [0.9, 0.0, 0.135]  # the ball fills the image
    plain = BallEngine(stripes=0.0)
    exact = CandidateView(camera, close, EXACT, 16)
    unsure = CandidateView(camera, close, position_covariance(0.02), 16)
    kept = variance_reduction(plain, unsure, PropagatedPosterior())
    assert kept == pytest.approx(variance_reduction(plain, exact, PropagatedPosterior()), rel=0.02)
    literal = variance_reduction(plain, unsure, LiteralPosterior())
    assert literal < 0.995 * variance_reduction(plain, exact, LiteralPosterior())


def sampled_colour_variance(engine, view, count):
    """Of renders at poses drawn from the covariance."""
    sigma = np.sqrt(np.diag(view.covariance))
    twists = np.random.default_rng(0).normal(size=(count, 6)) * sigma
    poses = view.T_world_camera @ se3.exp(twists)
    images = [engine.render(*camera_rays(view.camera, T, 16)).colour.mean(-1) for T in poses]
    return torch.stack(images).var(0)


def posterior_of(samples, pose_variance):
    noise = ray_variance(samples, len(pose_variance)) + pose_variance
    return posterior_variance(samples, noise[samples.ray_index])


def test_the_corrected_posterior_is_that_of_sampled_poses(camera, T_world_camera):
    engine, covariance = BallEngine(stripes=2.0), np.diag([1e-6, 4e-6, 1e-6, 1e-4, 1e-4, 1e-4])
    view = CandidateView(camera, T_world_camera, covariance, 16)
    predicted, sampled = pose_colour_variance(engine, view), sampled_colour_variance(engine, view, 1500)
    assert float(predicted.mean()) == pytest.approx(float(sampled.mean()), rel=0.1)
    busy = sampled > sampled.median()
    assert float(torch.corrcoef(torch.stack([predicted[busy], sampled[busy]]))[0, 1]) > 0.95
    samples = engine.sample(*camera_rays(camera, T_world_camera, 16))
    assert_close(posterior_of(samples, predicted), posterior_of(samples, sampled), rtol=0.1, atol=0)


def test_what_a_view_teaches_is_that_of_sampled_poses_where_colour_bends_too(camera, T_world_camera):
    engine = BallEngine(stripes=2.0)
    view = CandidateView(camera, T_world_camera, position_covariance(0.02), 16)
    samples = engine.sample(*camera_rays(camera, T_world_camera, 16))
    after = posterior_of(samples, sampled_colour_variance(engine, view, 1500))
    taught = float((samples.variance - after).sum()) / len(pose_colour_variance(engine, view))
    assert variance_reduction(engine, view, PropagatedPosterior()) == pytest.approx(taught, rel=0.1)


def test_colour_variance_never_exceeds_what_the_unit_interval_allows(camera, T_world_camera):
    view = CandidateView(camera, T_world_camera, np.eye(6), 16)
    assert float(pose_colour_variance(BallEngine(), view).max()) <= 0.25


def test_a_view_of_nothing_scores_zero(camera, T_world_camera):
    away = T_world_camera.copy()
    away[:3, 3] = [-30.0, 0.0, 0.0]
    for posterior in (PropagatedPosterior(), LiteralPosterior()):
        assert variance_reduction(BallEngine(), CandidateView(camera, away, EXACT, 8), posterior) == 0


def test_covariance_grows_with_the_square_of_the_move_and_feels_the_lever_arm(T_world_camera):
    moved = np.stack([T_world_camera, T_world_camera])
    moved[1, :3, 3] += [0.0, 0.5, 0.0]
    heading = np.zeros((6, 6))
    heading[1, 1] = 0.1**2  # about the camera's y, nearly vertical
    grown = covariance_after_move(T_world_camera, heading, moved, DriftConfig(0.0, 0.0))
    assert np.trace(grown[0, 3:, 3:]) == pytest.approx(0, abs=1e-12)
    assert np.sqrt(np.trace(grown[1, 3:, 3:])) == pytest.approx(0.5 * 0.1, rel=0.05)
    drift = covariance_after_move(T_world_camera, EXACT, moved, DriftConfig(0.02, 0.01))
    np.testing.assert_allclose(drift[1], np.diag([0.005**2] * 3 + [0.01**2] * 3), atol=1e-12)
