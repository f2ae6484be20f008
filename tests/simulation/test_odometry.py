import numpy as np
import pytest

from mulan.geometry import se3, so3
from mulan.simulation.odometry import OdometryNoiseConfig, simulate_odometry, start_frame

EXACT = OdometryNoiseConfig(
    translation_drift_percent=0.0, rotation_drift_deg_per_sqrt_m=0.0, tilt_sigma_deg=0.0
)


def _winding_path(n: int = 160):
    """A tilted, turning, 3-D path of about 25 m in 40 s."""
    s = np.linspace(0.0, 1.0, n)
    position = np.stack([3 + 4 * np.cos(6 * s), -1 + 4 * np.sin(6 * s), 1 + 0.5 * np.sin(9 * s)], -1)
    yaw = 6 * s + 0.7
    pitch = 0.4 * np.sin(5 * s) + 0.2
    zero = np.zeros(n)
    R = so3.about_z(yaw) @ so3.exp(np.stack([zero, pitch, zero], -1))
    return 40 * s, se3.from_parts(R, position)


def test_starts_at_the_origin_heading_along_x_with_true_roll_and_pitch():
    time_s, T = _winding_path()
    first = simulate_odometry(time_s, T, OdometryNoiseConfig(), np.random.default_rng(0)).T_odom_body[0]
    assert np.allclose(first[:3, 3], 0)
    assert abs(so3.yaw_rad(first[:3, :3])) < 1e-12
    assert np.allclose(first[2, :3], T[0, 2, :3]), "what gravity shows does not depend on the yaw frame"


def test_without_noise_it_is_the_true_motion_seen_from_the_start():
    time_s, T = _winding_path()
    track = simulate_odometry(time_s, T, EXACT, np.random.default_rng(0))
    assert np.allclose(start_frame(T[0]) @ track.T_odom_body, T, atol=1e-9)
    assert track.covariance is not None
    assert np.allclose(track.covariance, 0)


@pytest.mark.parametrize("sample", [30, 159])
def test_its_covariance_is_calibrated_in_every_degree_of_freedom(sample: int):
    time_s, T = _winding_path()
    time_s, T = time_s[: sample + 1], T[: sample + 1]
    noise = OdometryNoiseConfig(translation_drift_percent=2.0, rotation_drift_deg_per_sqrt_m=0.5)
    T_true = se3.inverse(start_frame(T[0])) @ T[-1]
    errors = []
    covariance = np.eye(6)
    for seed in range(300):
        track = simulate_odometry(time_s, T, noise, np.random.default_rng(seed))
        errors.append(se3.log(se3.inverse(T_true) @ track.T_odom_body[-1]))
        assert track.covariance is not None
        covariance = track.covariance[-1]
    errors = np.array(errors)
    nees_per_dof = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(covariance), errors) / 6
    assert nees_per_dof.mean() == pytest.approx(1.0, abs=0.12)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), errors.T)
    assert np.allclose(whitened @ whitened.T / len(errors), np.eye(6), atol=0.3)


def test_one_percent_means_a_centimetre_after_a_metre_on_each_axis():
    time_s = np.linspace(0.0, 1.0, 51)
    T = se3.from_parts(np.tile(np.eye(3), (51, 1, 1)), np.stack([time_s, 0 * time_s, 0 * time_s], -1))
    noise = OdometryNoiseConfig(rotation_drift_deg_per_sqrt_m=0.0)
    ends = [
        simulate_odometry(time_s, T, noise, np.random.default_rng(k)).T_odom_body[-1, :3, 3]
        for k in range(400)
    ]
    assert np.allclose(np.std(ends, axis=0), 0.01, rtol=0.15)


def test_gravity_keeps_roll_and_pitch_errors_small_while_yaw_wanders():
    time_s, T = _winding_path()
    track = simulate_odometry(time_s * 100, T, OdometryNoiseConfig(), np.random.default_rng(0))
    assert track.covariance is not None
    odom_axes = T[-1, :3, :3] @ track.covariance[-1, :3, :3] @ T[-1, :3, :3].T
    sigma_deg = np.rad2deg(np.sqrt(np.linalg.eigvalsh(odom_axes)))
    assert sigma_deg[:2] == pytest.approx(0.05, rel=0.01)
    assert sigma_deg[2] > 0.4
