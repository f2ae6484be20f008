"""The Gaussian localization leaves about the poses."""

import numpy as np
import pytest

from mulan.geometry import se3
from mulan.reconstruction.refinement.pose_prior import PosePrior, rigid_fit


def far_poses(rng, n=12):
    """Cameras about 8 m from the origin."""
    xi = rng.normal(size=(n, 6)) * [1, 1, 1, 4, 4, 4]
    return se3.exp(xi + np.array([0, 0, 0, 8.0, 0, 0]))


def joint_prior(rng, sigma_rigid=0.1, sigma_image=0.001):
    T = far_poses(rng)
    A = se3.adjoint(se3.inverse(T)).reshape(-1, 6)
    covariance = sigma_rigid**2 * A @ A.T + sigma_image**2 * np.eye(6 * len(T))
    return PosePrior(T, np.zeros(len(T), dtype=int), covariance)


def test_residual_of_the_estimates_is_zero():
    prior = joint_prior(np.random.default_rng(0))
    assert np.abs(prior.residual(prior.T_world_camera)).max() < 1e-9


def test_blocks_are_the_diagonal_of_the_joint_covariance():
    prior = joint_prior(np.random.default_rng(1))
    assert np.allclose(prior.blocks[3], prior.covariance[18:24, 18:24])


@pytest.mark.parametrize("turn_rad", [0.05, 0.15, 0.3])
def test_a_robot_turned_as_a_whole_costs_what_its_turn_deserves(turn_rad):
    """The tangent alone would find its images centimetres apart from each other, at millions of sigmas."""
    prior = joint_prior(np.random.default_rng(2))
    twist = np.array([0, 0, turn_rad, 0.1, -0.05, 0.02])
    residual = prior.residual(se3.exp(twist) @ prior.T_world_camera).reshape(-1)
    cost = residual @ prior.precision @ residual
    assert cost == pytest.approx(np.sum((twist / 0.1) ** 2), rel=1e-2)


def test_a_first_pose_known_exactly_does_not_blur_what_is_known_of_the_last():
    """As the graph's joint covariance of an anchor: nothing to ten centimetres, along one walk."""
    rng = np.random.default_rng(6)
    walk = np.tril(np.ones((12, 12)))
    covariance = np.kron(walk @ walk.T, 1e-4 * np.eye(6))
    covariance[:6] = covariance[:, :6] = 0
    prior = PosePrior(far_poses(rng), np.zeros(12, dtype=int), covariance)
    root = prior.root
    assert np.allclose(root @ root.T, covariance, atol=1e-12)
    x = np.zeros(72)
    x[6:] = 0.01 * rng.normal(size=66)
    rest = np.linalg.inv(covariance[6:, 6:])
    assert x @ prior.precision @ x == pytest.approx(x[6:] @ rest @ x[6:], rel=1e-4)
    kept = np.arange(12) > 3
    assert np.array_equal(prior.subset(kept).covariance, covariance[24:, 24:])


def test_moved_undoes_residual():
    rng = np.random.default_rng(3)
    prior = joint_prior(rng)
    twist = np.array([0.02, 0.1, 0.2, 0.1, 0.3, -0.1])
    T = se3.exp(twist) @ prior.T_world_camera @ se3.exp(1e-3 * rng.normal(size=(12, 6)))
    assert np.abs(prior.moved(prior.residual(T)) - T).max() < 2e-3


def test_independent_images_are_their_own_tangents():
    rng = np.random.default_rng(4)
    T, xi = far_poses(rng), 0.1 * rng.normal(size=(12, 6))
    prior = PosePrior(T, np.zeros(12, dtype=int), np.broadcast_to(np.eye(6), (12, 6, 6)).copy())
    assert np.allclose(prior.residual(T @ se3.exp(xi)), xi)
    assert np.allclose(prior.moved(xi), T @ se3.exp(xi))


def test_rigid_fit_finds_the_motion():
    T = far_poses(np.random.default_rng(5))
    G = se3.exp(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
    assert np.allclose(rigid_fit(T, G @ T), G)
