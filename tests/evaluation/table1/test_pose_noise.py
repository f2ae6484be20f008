import math
from functools import cache

import numpy as np
import pytest

from mulan.evaluation.table1.pose_noise import (
    RadioNoiseConfig,
    RigidNoiseConfig,
    poses_from_radio,
    rigidly_displaced_poses,
)
from mulan.geometry import se3

from ...reconstruction.cube_scene import look_at

N = 1500


@cache
def cameras(n=N):
    rng = np.random.default_rng(5)
    azimuth, height = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.5, 3.0, n)
    return np.stack(
        [look_at((4 * math.cos(a), 4 * math.sin(a), h)) for a, h in zip(azimuth, height, strict=True)]
    )


def errors(believed, true):
    return se3.log(se3.inverse(believed) @ true)


def nees(believed, true, covariance):
    xi = errors(believed, true)
    return (xi * np.linalg.solve(covariance, xi[..., None])[..., 0]).sum(1)


def heard(sigma_deg, seed=0):
    """Poses believed from radio of the given accuracy, and the true ones."""
    rng = np.random.default_rng(seed)
    T = cameras()
    observer = np.array([5.0, -1.0, 1.0]) + rng.normal(0, 0.3, (N, 3))
    sigma = np.radians(np.broadcast_to(sigma_deg, N))
    return poses_from_radio(T, observer, rng.normal(0, sigma), sigma, RadioNoiseConfig(), rng), T, observer


@pytest.mark.parametrize("sigma_deg", [1.0, 5.0, 15.0])
def test_covariance_of_a_radio_pose_is_as_large_as_its_errors(sigma_deg):
    believed, T, _ = heard(sigma_deg)
    values = nees(believed.T_world_camera, T, believed.covariance)
    # the mean of N chi-squared numbers of 6 degrees of freedom, at five standard deviations
    assert values.mean() == pytest.approx(6, abs=4 * math.sqrt(2 * 6 / N))


def test_each_direction_of_a_radio_pose_is_calibrated_by_itself():
    believed, T, _ = heard(5.0)
    xi = errors(believed.T_world_camera, T)
    scale = np.sqrt(np.einsum("nii->ni", believed.covariance))
    np.testing.assert_allclose((xi / scale).std(0), 1, atol=0.1)
    np.testing.assert_allclose((xi / scale).mean(0), 0, atol=0.1)


def test_a_position_is_off_across_the_line_of_sight_by_range_times_angle():
    believed, T, observer = heard(5.0)
    offset = T[:, :3, 3] - observer
    across = np.cross([0.0, 0.0, 1.0], offset)
    error = believed.T_world_camera[:, :3, 3] - T[:, :3, 3]
    lever = np.linalg.norm(across, axis=1)
    angle = (error * across).sum(1) / lever**2
    assert np.degrees(angle.std()) == pytest.approx(5.0, rel=0.05)
    assert error[:, 2].std() == pytest.approx(0.05, rel=0.05)


def test_bearings_of_known_spread_are_believed_as_far_as_each_deserves():
    sigma_deg = np.random.default_rng(1).uniform(1, 15, N)
    believed, T, _ = heard(sigma_deg)
    values = nees(believed.T_world_camera, T, believed.covariance)
    for part in np.array_split(np.argsort(sigma_deg), 4):
        assert values[part].mean() == pytest.approx(6, abs=1.0)


@pytest.mark.parametrize("sigma_deg", [5.0, 60.0])
def test_a_camera_at_its_likeliest_place_is_on_the_arc_and_admits_how_far_it_may_be(sigma_deg):
    rng = np.random.default_rng(2)
    T, observer = cameras(), np.tile([5.0, -1.0, 1.0], (N, 1))
    sigma = np.full(N, math.radians(sigma_deg))
    error, config = rng.normal(0, sigma), RadioNoiseConfig()
    believed = poses_from_radio(T, observer, error, sigma, config, rng, likeliest=True)
    range_m = np.linalg.norm(believed.T_world_camera[:, :3, 3] - observer, axis=1)
    np.testing.assert_allclose(range_m, np.linalg.norm(T[:, :3, 3] - observer, axis=1), atol=0.3)
    values = nees(believed.T_world_camera, T, believed.covariance)
    assert values.mean() == pytest.approx(6, abs=4 * math.sqrt(2 * 6 / N))


@pytest.mark.parametrize(("displacement_m", "turn_deg"), [(0.4, 7.0), (1.2, 21.0)])
def test_joint_covariance_of_a_rigid_error_is_as_large_as_the_error(displacement_m, turn_deg):
    T = cameras(12)
    values = []
    for seed in range(60):
        config = RigidNoiseConfig(displacement_m, turn_deg)
        believed = rigidly_displaced_poses(T, config, np.random.default_rng(seed))
        xi = errors(believed.T_world_camera, T).reshape(-1)
        assert believed.joint_covariance is not None
        values.append(xi @ np.linalg.solve(believed.joint_covariance, xi))
    # the common six degrees of freedom hardly vary, since the displacement's size is given
    assert np.mean(values) == pytest.approx(72, rel=0.05)


def test_a_rigid_error_displaces_the_middle_and_turns_by_what_was_asked():
    T = cameras(50)
    config = RigidNoiseConfig(0.4, 7.0, 0.0, 0.0, 0.0)
    believed = rigidly_displaced_poses(T, config, np.random.default_rng(0)).T_world_camera
    shift = believed[:, :3, 3].mean(0) - T[:, :3, 3].mean(0)
    assert np.linalg.norm(shift) == pytest.approx(0.4, rel=0.01)
    turn = se3.log(believed @ se3.inverse(T))[:, :3]
    np.testing.assert_allclose(np.degrees(np.linalg.norm(turn, axis=1)), 7.0, rtol=1e-6)


def test_diagonal_blocks_of_the_joint_covariance_are_the_images_own():
    believed = rigidly_displaced_poses(cameras(4), RigidNoiseConfig(), np.random.default_rng(0))
    assert believed.joint_covariance is not None
    for i in range(4):
        block = believed.joint_covariance[6 * i : 6 * i + 6, 6 * i : 6 * i + 6]
        np.testing.assert_array_equal(block, believed.covariance[i])
