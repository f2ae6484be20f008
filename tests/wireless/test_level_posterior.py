import numpy as np
import pytest

from mulan.wireless.apertures import Aperture
from mulan.wireless.bearing import BearingConfig, bearing_of_aperture
from mulan.wireless.directions import unit_direction
from mulan.wireless.level_posterior import LevelPosteriorConfig, level_hypotheses

from .signals import SUBCARRIER_HZ, WAVELENGTH_M, aperture_channel, helix, robot


def _wide(channel):
    return np.repeat(channel[:, None], len(SUBCARRIER_HZ), 1)


def _azimuth_error_deg(direction, azimuth_rad):
    return np.degrees(
        np.abs(np.angle(np.exp(1j * (np.arctan2(direction[:, 1], direction[:, 0]) - azimuth_rad))))
    )


def test_the_direct_path_is_among_three_hypotheses_beside_reflections():
    rng = np.random.default_rng(30)
    path = helix(300, level=True)
    hits = 0
    for _ in range(20):
        azimuth = rng.uniform(-np.pi, np.pi)
        ghosts = [
            (path.mean(0) + 5.0 * unit_direction(np.array(rng.uniform(-np.pi, np.pi)), np.array(0.0)), gain)
            for gain in (0.9, 0.6)
        ]
        source = path.mean(0) + 3.0 * unit_direction(np.array(azimuth), np.array(0.0))
        channel = _wide(aperture_channel(path, source, rng, 0.2, ghosts))
        found = level_hypotheses(path, channel, WAVELENGTH_M, None, 30.0, LevelPosteriorConfig())
        assert found.weight.sum() + found.outlier_mass == pytest.approx(1.0)
        hits += _azimuth_error_deg(found.direction[:3], azimuth).min() < 5
    assert hits >= 18


def test_a_path_of_wrong_scale_keeps_its_azimuth():
    rng = np.random.default_rng(31)
    path = helix(300, level=True)
    for azimuth in (-2.0, 0.3, 1.4):
        source = path.mean(0) + 3.0 * unit_direction(np.array(azimuth), np.array(0.0))
        channel = _wide(aperture_channel(path, source, rng, 0.2))
        config = LevelPosteriorConfig(path_scale_sigma=0.05)
        found = level_hypotheses(1.06 * path, channel, WAVELENGTH_M, None, 300.0, config)
        assert _azimuth_error_deg(found.direction[:1], azimuth)[0] < 2.0


@pytest.mark.parametrize("reflection", [0.0, 0.7])
def test_only_smooth_residuals_are_judged_as_reflections(reflection):
    rng = np.random.default_rng(32)
    path = helix(400, level=True)
    source, mirror = np.array([3.0, 1.0, 0.0]), np.array([-2.0, 3.0, 0.0])
    channel = aperture_channel(path, source, rng, 0.3, [(mirror, reflection)])
    time_s = np.linspace(0.0, 4.0, 400)
    aperture = Aperture("a", "b", time_s, time_s, path, _wide(channel), WAVELENGTH_M, 200, np.eye(4))
    still = robot("a", np.array([0.0, 4.0]), np.tile(np.eye(4), (2, 1, 1)))
    bearing = bearing_of_aperture(
        aperture,
        still,
        float(np.linalg.norm(source - path.mean(0))),
        BearingConfig(assumed_drift_percent=0.0),
    )
    assert bearing is not None
    sigma_deg = np.degrees(np.sqrt(bearing.tangent_covariance[0, 0, 0]))
    assert (sigma_deg < 0.3) == (reflection == 0.0)
