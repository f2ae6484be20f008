import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mulan.geometry import se3, so3

from .strategies import transforms, twists, vectors


@given(transforms(), transforms(), transforms())
def test_composition_is_associative(A, B, C):
    np.testing.assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-11)


@given(transforms())
def test_inverse_undoes_from_both_sides(T):
    np.testing.assert_allclose(T @ se3.inverse(T), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(se3.inverse(T) @ T, np.eye(4), atol=1e-12)


@given(transforms(), transforms(), vectors(10.0))
def test_composition_acts_on_points_one_after_the_other(A, B, point):
    np.testing.assert_allclose(
        se3.transform(A @ B, point), se3.transform(A, se3.transform(B, point)), atol=1e-11
    )


@given(twists())
def test_log_undoes_exp_from_zero_to_pi(xi):
    np.testing.assert_allclose(se3.log(se3.exp(xi)), xi, atol=1e-7)


@given(transforms())
def test_exp_undoes_log(T):
    np.testing.assert_allclose(se3.exp(se3.log(T)), T, atol=1e-9)


@given(twists(), st.floats(-1, 1), st.floats(-1, 1))
def test_one_twist_generates_a_one_parameter_group(xi, a, b):
    np.testing.assert_allclose(se3.exp(a * xi) @ se3.exp(b * xi), se3.exp((a + b) * xi), atol=1e-10)


@given(transforms(), twists())
def test_the_adjoint_moves_a_perturbation_from_right_to_left(T, xi):
    np.testing.assert_allclose(T @ se3.exp(xi), se3.exp(se3.adjoint(T) @ xi) @ T, atol=1e-8)


@given(transforms(), transforms())
def test_the_adjoint_is_a_homomorphism(A, B):
    np.testing.assert_allclose(se3.adjoint(A @ B), se3.adjoint(A) @ se3.adjoint(B), atol=1e-9)


def test_covariance_of_a_composition_is_that_of_random_draws():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) * 2e-3
    covariance = root @ root.T
    T_a_b = se3.exp(np.array([0.3, -0.7, 1.2, 1.0, -2.0, 0.5]))
    T_b_c = se3.exp(np.array([-0.4, 0.1, 0.9, 0.3, 0.8, -1.5]))
    xi = rng.multivariate_normal(np.zeros(6), covariance, size=40_000)
    drawn = se3.log(se3.inverse(T_a_b @ T_b_c) @ T_a_b @ se3.exp(xi) @ T_b_c)
    expected = se3.covariance_of_composition(T_b_c, covariance)
    sigma = np.sqrt(np.diag(expected))
    # correlations of 40 000 draws scatter by 1/sqrt(40 000) = 0.005
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=0.03
    )


@given(transforms(), transforms(), st.floats(-5, 5), st.floats(0.1, 5))
def test_interpolation_meets_the_samples_and_holds_the_ends(A, B, start_s, duration_s):
    time_s = np.array([start_s, start_s + duration_s])
    query_s = np.array([start_s - 1, start_s, start_s + duration_s, start_s + duration_s + 1])
    found = se3.interpolate(time_s, np.stack([A, B]), query_s)
    np.testing.assert_allclose(found, np.stack([A, A, B, B]), atol=1e-8)


@given(transforms(), twists(), st.floats(0, 1))
def test_interpolation_runs_along_the_geodesic_at_even_speed(T, xi, fraction):
    ends = np.stack([T, T @ se3.exp(xi)])
    found = se3.interpolate(np.array([0.0, 2.0]), ends, np.array([2 * fraction]))[0]
    np.testing.assert_allclose(found, T @ se3.exp(fraction * xi), atol=1e-8)


def test_interpolation_picks_the_neighbouring_samples():
    turns = se3.from_parts(so3.about_z(np.array([0.0, 0.2, 1.0])), np.zeros((3, 3)))
    found = se3.interpolate(np.array([0.0, 1.0, 3.0]), turns, np.array([0.5, 1.0, 2.0]))
    np.testing.assert_allclose(so3.yaw_rad(found[:, :3, :3]), [0.1, 0.2, 0.6], atol=1e-12)


def test_a_single_sample_is_held_everywhere():
    T = se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    found = se3.interpolate(np.array([5.0]), T[None], np.array([0.0, 5.0, 9.0]))
    np.testing.assert_array_equal(found, np.stack([T, T, T]))


def test_a_screw_motion_follows_its_axis():
    """A full turn about z while climbing one metre ends above the start."""
    T = se3.exp(np.array([0.0, 0.0, 2 * math.pi, 0.0, 0.0, 1.0]))
    np.testing.assert_allclose(T, se3.from_parts(np.eye(3), np.array([0.0, 0.0, 1.0])), atol=1e-12)
