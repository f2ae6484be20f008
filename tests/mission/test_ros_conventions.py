import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mulan.geometry import se3, so3
from mulan.mission import ros_poses, ros_stamps


def test_ros_covariance_is_that_of_random_draws_about_fixed_axes():
    """Draw right perturbations; measure (x, y, z) and the small rotations about the parent's axes."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(6, 6)) * 2e-3
    covariance = root @ root.T
    T = se3.exp(np.array([0.4, -0.9, 1.3, 3.0, -2.0, 1.0]))
    moved = T @ se3.exp(rng.multivariate_normal(np.zeros(6), covariance, size=40_000))
    turned = so3.log(moved[:, :3, :3] @ T[:3, :3].T)
    drawn = np.concatenate([moved[:, :3, 3] - T[:3, 3], turned], axis=1)
    expected = ros_poses.covariance_to_ros(T, covariance)
    sigma = np.sqrt(np.diag(expected))
    scale = np.outer(sigma, sigma)
    np.testing.assert_allclose(np.cov(drawn.T) / scale, expected / scale, atol=0.03)


def test_forward_uncertainty_of_a_robot_facing_north_is_ros_y():
    T = se3.from_parts(so3.about_z(math.pi / 2), np.zeros(3))
    ours = np.diag([0.0, 0.0, 0.0, 4.0, 0.0, 0.0])  # body x
    np.testing.assert_allclose(
        ros_poses.covariance_to_ros(T, ours), np.diag([0.0, 4.0, 0.0, 0.0, 0.0, 0.0]), atol=1e-12
    )


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10_000))
def test_covariance_survives_the_way_to_ros_and_back(seed):
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(size=(3, 6)) * 2)
    root = rng.normal(size=(3, 6, 6))
    covariance = root @ np.swapaxes(root, 1, 2)
    there = ros_poses.covariance_to_ros(T, covariance)
    np.testing.assert_allclose(ros_poses.covariance_from_ros(T, there), covariance, atol=1e-12)
    back = ros_poses.covariance_from_ros(T, covariance)
    np.testing.assert_allclose(ros_poses.covariance_to_ros(T, back), covariance, atol=1e-12)


@settings(deadline=None)
@given(st.floats(0, 2**31 - 2))
def test_stamps_keep_time_to_half_a_nanosecond(time_s):
    time_ns = ros_stamps.to_nanoseconds(time_s)
    stamp = ros_stamps.to_stamp(time_ns)
    assert 0 <= stamp.nanosec < 10**9
    back = stamp.sec + stamp.nanosec / 10**9
    assert abs(back - time_s) <= 0.5e-9 + math.ulp(time_s)


@pytest.mark.parametrize("time_s", [-1e-9, math.nan, math.inf, 2.0**31])
def test_times_a_stamp_cannot_hold_are_refused(time_s):
    with pytest.raises(ValueError, match="does not fit"):
        ros_stamps.to_nanoseconds(time_s)
