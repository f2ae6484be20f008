import numpy as np
import pytest

from mulan.geometry import se3
from mulan.planning.candidates import look_at
from mulan.planning.radio_fix import RadioFixConfig, Teammate, covariance_after_radio

POSE = look_at(np.array([2.0, 0.0, 0.5]), np.zeros(3), np.array([0.0, 1.0, 0.0]))[None]
LOOSE = np.diag([0.02**2] * 3 + [0.5**2] * 3)[None]
CONFIG = RadioFixConfig(0.1, 0.05)


def mate(x, y, z=0.5, sigma_m=0.0):
    return Teammate(np.array([x, y, z]), sigma_m**2 * np.eye(3))


def world_position(covariance):
    R = POSE[0, :3, :3]
    return R @ covariance[0, 3:, 3:] @ R.T


def test_a_range_fixes_the_distance_and_a_bearing_what_is_across_it():
    position = world_position(covariance_after_radio(POSE, LOOSE, [mate(6.0, 0.0)], CONFIG))
    assert np.sqrt(position[0, 0]) == pytest.approx(0.1, rel=0.05)
    # across: 4 m times bearing and heading together
    assert np.sqrt(position[1, 1]) == pytest.approx(4 * np.hypot(0.05, 0.02), rel=0.2)
    assert position[1, 1] < LOOSE[0, 4, 4]


def test_teammates_in_different_directions_say_more_than_twice_the_same():
    same = world_position(covariance_after_radio(POSE, LOOSE, [mate(10, 0), mate(10, 0)], CONFIG))
    apart = world_position(covariance_after_radio(POSE, LOOSE, [mate(10, 0), mate(2, 8)], CONFIG))
    assert np.trace(apart) < 0.6 * np.trace(same)


def test_a_teammate_that_hardly_knows_where_it_is_helps_little_and_one_out_of_range_not_at_all():
    sure, unsure = (
        np.trace(world_position(covariance_after_radio(POSE, LOOSE, [mate(6, 0, sigma_m=s)], CONFIG)))
        for s in (0.0, 3.0)
    )
    before = np.trace(LOOSE[0, 3:, 3:])
    assert sure < unsure < before
    far = covariance_after_radio(POSE, LOOSE, [mate(60, 0)], CONFIG)
    np.testing.assert_allclose(far, LOOSE)


def test_the_covariance_is_that_of_sampled_estimates():
    """Least squares on drawn errors, linear about the truth, scatter as the covariance says."""
    rng = np.random.default_rng(0)
    prior = np.diag([0.01**2] * 3 + [0.1**2] * 3)
    teammates = [mate(5, 1), mate(1, 4, 1.5)]
    predicted = covariance_after_radio(POSE, prior[None], teammates, CONFIG)[0]
    xi = rng.normal(size=(4000, 6)) * np.sqrt(np.diag(prior))
    residuals, noises, jacobians = [], [], []
    eps = 1e-6
    for teammate in teammates:

        def seen(T, q=teammate.position_m):
            p = (se3.inverse(T) @ np.append(q, 1.0))[:3]
            return p

        p0 = seen(POSE[0])
        distance = np.linalg.norm(p0)
        axes = np.vstack([p0 / distance, np.linalg.svd((p0 / distance)[None])[2][1:] / distance])
        J = np.stack([(axes @ (seen(POSE[0] @ se3.exp(eps * e)) - p0)) / eps for e in np.eye(6)], -1)
        sigma = np.array([0.1, 0.05, 0.05])
        jacobians.append(J)
        noises.append(np.diag(1 / sigma**2))
        residuals.append(xi @ J.T + rng.normal(size=(4000, 3)) * sigma)
    information = np.linalg.inv(prior) + sum(J.T @ W @ J for J, W in zip(jacobians, noises, strict=True))
    estimate = np.linalg.solve(
        information,
        sum(J.T @ W @ r.T for J, W, r in zip(jacobians, noises, residuals, strict=True)),
    ).T
    sampled = np.cov((xi - estimate).T)
    np.testing.assert_allclose(np.sqrt(np.diag(sampled)), np.sqrt(np.diag(predicted)), rtol=0.05)
