import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mulan.geometry import so3

from .strategies import numbers, rotation_vectors, unit_vectors, vectors


@given(rotation_vectors())
def test_exp_gives_a_rotation(w):
    R = so3.exp(w)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-13)


@given(rotation_vectors())
def test_exp_is_scipys_rotation(w):
    np.testing.assert_allclose(so3.exp(w), Rotation.from_rotvec(w).as_matrix(), atol=1e-13)


@given(rotation_vectors())
def test_log_undoes_exp_from_zero_to_pi(w):
    np.testing.assert_allclose(so3.log(so3.exp(w)), w, atol=1e-9)


@given(unit_vectors())
def test_log_at_half_a_turn_is_either_end_of_the_axis(axis):
    w = so3.log(so3.exp(math.pi * axis))
    assert np.linalg.norm(w) == pytest.approx(math.pi, abs=1e-9)
    np.testing.assert_allclose(so3.exp(w), so3.exp(math.pi * axis), atol=1e-9)


@given(rotation_vectors(2 * math.pi))
def test_log_is_never_longer_than_half_a_turn(w):
    assert np.linalg.norm(so3.log(so3.exp(w))) <= math.pi + 1e-12


def test_small_angles_keep_full_relative_precision():
    for angle in 10.0 ** -np.arange(2, 13):
        w = angle * np.array([0.6, 0.0, 0.8])
        np.testing.assert_allclose(so3.log(so3.exp(w)), w, rtol=1e-9)


@given(vectors(10.0), vectors(10.0))
def test_hat_is_the_cross_product(w, v):
    np.testing.assert_allclose(so3.hat(w) @ v, np.cross(w, v), atol=1e-12)


@given(rotation_vectors())
def test_quaternions_round_trip_and_are_unit_with_positive_real_part(w):
    R = so3.exp(w)
    q = so3.to_quaternion(R)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
    assert q[3] >= 0
    np.testing.assert_allclose(so3.from_quaternion(q), R, atol=1e-13)


@given(rotation_vectors(), st.floats(0.5, 2.0))
def test_quaternions_of_any_length_and_sign_are_the_same_rotation(w, length):
    q = so3.to_quaternion(so3.exp(w))
    np.testing.assert_allclose(so3.from_quaternion(-length * q), so3.from_quaternion(q), atol=1e-13)


def test_the_quaternion_of_a_quarter_turn_about_z_is_x_y_z_w():
    q = so3.to_quaternion(so3.about_z(np.array(math.pi / 2)))
    np.testing.assert_allclose(q, [0, 0, math.sqrt(0.5), math.sqrt(0.5)], atol=1e-15)


@given(numbers(3.14))
def test_yaw_is_read_back_from_a_turn_about_the_vertical(yaw):
    assert float(so3.yaw_rad(so3.about_z(np.array(yaw)))) == pytest.approx(yaw, abs=1e-12)


@given(rotation_vectors())
def test_the_left_jacobian_integrates_the_rotation(w):
    """V(w) = ∫ exp(s w) ds over [0, 1], by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    integral = np.tensordot(weights / 2, so3.exp((nodes[:, None] + 1) / 2 * w), 1)
    np.testing.assert_allclose(so3.left_jacobian(w), integral, atol=1e-11)


def test_batches_of_any_shape_agree_with_one_at_a_time():
    rng = np.random.default_rng(0)
    w = rng.normal(size=(2, 3, 3))
    R = so3.exp(w)
    assert R.shape == (2, 3, 3, 3)
    assert so3.to_quaternion(R).shape == (2, 3, 4)
    np.testing.assert_allclose(so3.log(R)[1, 2], so3.log(R[1, 2]))
    np.testing.assert_allclose(R[0, 1], so3.exp(w[0, 1]))
