import numpy as np
import pytest

from mulan.wireless.directions import tangent_basis, unit_direction
from mulan.wireless.drift_tracking import tracked_peaks
from mulan.wireless.kappa_paper import kappa_paper
from mulan.wireless.peak import grid_peaks, refine_direction, refined_peaks, steering_model
from mulan.wireless.profile import bartlett_power, unit_sum_profile
from mulan.wireless.uncertainty import hypothesis_weights, residual_statistics, sandwich_covariance

from .signals import WAVELENGTH_M, aperture_channel, helix


@pytest.mark.parametrize("phase_noise_rad", [0.1, 0.42, 1.0])
def test_bearing_sigma_is_calibrated(phase_noise_rad):
    rng = np.random.default_rng(10)
    path = helix(250)
    normalised = []
    for _ in range(200):
        true = unit_direction(np.array(rng.uniform(-np.pi, np.pi)), np.array(rng.uniform(-0.8, 0.8)))
        channel = aperture_channel(path, path.mean(0) + 4.0 * true, rng, phase_noise_rad)
        model = steering_model(path, WAVELENGTH_M, 4.0)
        u = refine_direction(model, channel, true)
        error = tangent_basis(u).T @ (true - u)
        normalised.append(np.linalg.solve(np.linalg.cholesky(sandwich_covariance(model, channel, u)), error))
    ratio = np.sqrt(np.mean(np.square(normalised)))
    assert 0.85 < ratio < 1.2


def test_bearing_sigma_covers_odometry_drift_along_the_path():
    rng = np.random.default_rng(11)
    path = helix(250)
    step_m = np.linalg.norm(np.diff(path, axis=0), axis=1)
    variance = np.concatenate([[0.0], np.cumsum(0.005**2 * step_m)])
    normalised = []
    for _ in range(200):
        true = unit_direction(np.array(rng.uniform(-np.pi, np.pi)), np.array(rng.uniform(-0.8, 0.8)))
        channel = aperture_channel(path, path.mean(0) + 4.0 * true, rng, 0.42)
        walk = np.cumsum(rng.normal(size=(250, 3)) * np.sqrt(np.diff(variance, prepend=0.0))[:, None], axis=0)
        model = steering_model(path + walk, WAVELENGTH_M, 4.0)
        u = refine_direction(model, channel, true)
        covariance = sandwich_covariance(model, channel, u, variance)
        normalised.append(np.linalg.solve(np.linalg.cholesky(covariance), tangent_basis(u).T @ (true - u)))
    ratio = np.sqrt(np.mean(np.square(normalised)))
    assert 0.8 < ratio < 1.25


def test_a_level_path_has_infinite_elevation_variance_and_a_good_azimuth():
    rng = np.random.default_rng(12)
    path = helix(250, level=True)
    error_deg = []
    for azimuth in np.linspace(-3, 3, 9):
        true = unit_direction(np.array(azimuth), np.array(0.1))
        channel = aperture_channel(path, path.mean(0) + 4.0 * true, rng, 0.3)
        model = steering_model(path, WAVELENGTH_M, 4.0)
        power = bartlett_power(path, channel, WAVELENGTH_M)
        u = refined_peaks(model, channel, power, 1)[0]
        covariance = sandwich_covariance(model, channel, u)
        assert np.isinf(covariance[1, 1])
        assert np.isfinite(covariance[0, 0])
        error_deg.append(np.degrees(np.abs(np.arctan2(u[1], u[0]) - azimuth)))
    assert max(error_deg) < 1.0


def test_pi_jumps_of_a_card_do_not_shrink_sigma():
    rng = np.random.default_rng(13)
    path = helix(250)
    true = unit_direction(np.array(0.5), np.array(0.2))
    clean = aperture_channel(path, path.mean(0) + 4.0 * true, rng, 0.05)
    jumped = clean * np.where(rng.random(250) < 0.3, -1.0, 1.0)
    model = steering_model(path, WAVELENGTH_M, 4.0)
    assert (
        residual_statistics(model, jumped, true).variance_rad2
        > 50 * residual_statistics(model, clean, true).variance_rad2
    )


def test_lasting_residuals_count_as_fewer_packets():
    rng = np.random.default_rng(14)
    path = helix(400)
    true = unit_direction(np.array(0.5), np.array(0.2))
    model = steering_model(path, WAVELENGTH_M, 4.0)
    white = aperture_channel(path, path.mean(0) + 4.0 * true, rng, 0.4)
    slow = np.convolve(rng.normal(size=430), np.ones(31) / np.sqrt(31), "valid") * 0.4
    lasting = aperture_channel(path, path.mean(0) + 4.0 * true, rng, 0.0) * np.exp(1j * slow)
    assert residual_statistics(model, white, true).correlation_packets < 1.6
    assert residual_statistics(model, lasting, true).correlation_packets > 5


def test_weights_trust_a_clean_link_and_distrust_noise():
    rng = np.random.default_rng(15)
    path = helix(300)
    true = unit_direction(np.array(0.5), np.array(0.2))
    masses = []
    for noise_rad in (0.3, 3.0):
        channel = aperture_channel(path, path.mean(0) + 4.0 * true, rng, noise_rad)
        channel = channel / np.abs(channel).mean()
        model = steering_model(path, WAVELENGTH_M, 4.0)
        power = bartlett_power(path, channel, WAVELENGTH_M)
        directions = refined_peaks(model, channel, power, 3)
        weight, outlier_mass = hypothesis_weights(model, channel, power, directions)
        assert weight.sum() + outlier_mass == pytest.approx(1.0)
        masses.append(outlier_mass)
    assert masses[0] == pytest.approx(0.01)
    assert masses[1] > 0.3


def test_kappa_of_the_paper_grows_with_phase_noise():
    path = helix(300)
    true = unit_direction(np.array(3.1), np.array(0.2))  # the window wraps at 180 degrees
    kappa = []
    for noise_rad in (0.1, 0.8, 1.6):
        rng = np.random.default_rng(16)
        channel = aperture_channel(path, path.mean(0) + 30.0 * true, rng, noise_rad)
        profile = unit_sum_profile(bartlett_power(path, channel, WAVELENGTH_M))
        kappa.append(kappa_paper(profile, path, WAVELENGTH_M))
    assert kappa[0] < kappa[1] < kappa[2]
    assert 1e3 < kappa[0] < 5e6


@pytest.mark.parametrize("level", [False, True])
def test_drift_of_one_percent_is_tracked_with_a_calibrated_sigma(level):
    rng = np.random.default_rng(17)
    path = helix(300, level=level)
    variance = np.concatenate([[0.0], np.cumsum(0.01**2 * np.linalg.norm(np.diff(path, axis=0), axis=1))])
    normalised, tracked_deg, coherent_deg = [], [], []
    for _ in range(60):
        elevation = rng.uniform(-0.2, 0.2) if level else rng.uniform(-0.8, 0.8)
        true = unit_direction(np.array(rng.uniform(-np.pi, np.pi)), np.array(elevation))
        channel = aperture_channel(path, path.mean(0) + 4.0 * true, rng, 0.42)
        walk = np.cumsum(rng.normal(size=(300, 3)) * np.sqrt(np.diff(variance, prepend=0.0))[:, None], axis=0)
        model = steering_model(path + walk, WAVELENGTH_M, 4.0)
        if level:
            model = steering_model((path + walk) * [1.0, 1.0, 0.0], WAVELENGTH_M, 4.0)
        starts = grid_peaks(bartlett_power(path + walk, channel, WAVELENGTH_M, 180, 91), 12, 0.1)
        best = tracked_peaks(model, channel, starts, variance, level)[0]
        assert np.isinf(best.covariance[1, 1]) == level
        error = tangent_basis(best.direction).T @ (true - best.direction)
        if level:
            angle = np.arctan2(np.cross(best.direction, true)[2], best.direction[:2] @ true[:2])
            normalised.append(angle / np.sqrt(best.covariance[0, 0]))
            continue
        normalised += list(np.linalg.solve(np.linalg.cholesky(best.covariance), error))
        tracked_deg.append(np.degrees(np.linalg.norm(error)))
        coherent_deg.append(np.degrees(np.linalg.norm(true - refine_direction(model, channel, starts[0]))))
    assert 0.8 < np.sqrt(np.mean(np.square(normalised))) < 1.25
    if not level:
        assert np.sqrt(np.mean(np.square(tracked_deg))) < 0.5 * np.sqrt(np.mean(np.square(coherent_deg)))
