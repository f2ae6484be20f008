import numpy as np
import pytest

from mulan.wireless.directions import azimuth_elevation, direction_grid, tangent_basis, unit_direction
from mulan.wireless.peak import grid_peaks, refine_direction, refined_peaks, steering_model
from mulan.wireless.profile import bartlett_power, bartlett_power_reference, unit_sum_profile

from .signals import WAVELENGTH_M, aperture_channel, helix


@pytest.mark.parametrize("round_trip", [True, False])
@pytest.mark.parametrize("n", [7, 192, 431])
def test_fast_profile_equals_the_definition(n, round_trip):
    rng = np.random.default_rng(n)
    position = rng.normal(size=(n, 3)) * [0.3, 0.2, 0.1] + [5.0, -2.0, 1.0]
    channel = rng.normal(size=n) + 1j * rng.normal(size=n)
    azimuth, elevation = direction_grid(72, 37)
    expected = bartlett_power_reference(position, channel, WAVELENGTH_M, azimuth, elevation, round_trip)
    power = bartlett_power(position, channel, WAVELENGTH_M, 72, 37, round_trip)
    np.testing.assert_allclose(power, expected, atol=2e-5 * expected.max())
    assert unit_sum_profile(power).power.sum(dtype=float) == pytest.approx(1.0, abs=1e-5)


def test_powers_of_several_channels_add_up():
    rng = np.random.default_rng(4)
    position = rng.normal(size=(120, 3)) * [0.3, 0.2, 0.1]
    channels = rng.normal(size=(120, 5)) + 1j * rng.normal(size=(120, 5))
    azimuth, elevation = direction_grid(72, 37)
    each = [bartlett_power_reference(position, h, WAVELENGTH_M, azimuth, elevation) for h in channels.T]
    together = bartlett_power(position, channels, WAVELENGTH_M, 72, 37)
    np.testing.assert_allclose(together, np.sum(each, 0), atol=2e-5 * np.max(np.sum(each, 0)))


def test_the_peak_points_at_the_source_and_not_away_from_it():
    rng = np.random.default_rng(0)
    source = np.array([40.0, -25.0, 15.0])
    path = helix(300)
    channel = aperture_channel(path, source, rng, 0.1)
    u = grid_peaks(bartlett_power(path, channel, WAVELENGTH_M), 1, 0.5)[0]
    true = (source - path.mean(0)) / np.linalg.norm(source - path.mean(0))
    assert np.degrees(np.arccos(u @ true)) < 1.0


def test_refinement_beats_the_grid_and_reaches_the_noise_free_direction():
    path = helix(300)
    rng = np.random.default_rng(1)
    for _ in range(20):
        true = unit_direction(np.array(rng.uniform(-np.pi, np.pi)), np.array(rng.uniform(-1.2, 1.2)))
        channel = aperture_channel(path, path.mean(0) + 3.0 * true, rng, 0.0)
        model = steering_model(path, WAVELENGTH_M, 3.0)
        u = refined_peaks(model, channel, bartlett_power(path, channel, WAVELENGTH_M), 1)[0]
        assert np.degrees(np.linalg.norm(u - true)) < 0.01


def test_spherical_steering_removes_the_near_field_error():
    path = helix(300, radius_m=0.5)
    rng = np.random.default_rng(2)
    errors: dict[bool, list[float]] = {True: [], False: []}
    for azimuth in np.linspace(-3, 3, 13):
        true = unit_direction(np.array(azimuth), np.array(0.4))
        channel = aperture_channel(path, path.mean(0) + 2.5 * true, rng, 0.0)
        for spherical in (True, False):
            model = steering_model(path, WAVELENGTH_M, 2.6 if spherical else None)
            u = refine_direction(model, channel, true)
            errors[spherical].append(float(np.degrees(np.linalg.norm(u - true))))
    assert np.median(errors[True]) < 0.35 * np.median(errors[False])


def test_peaks_are_found_across_the_azimuth_seam():
    power = np.ones((37, 72), np.float32)
    power[20, 0] = 9.0
    power[20, 71] = 8.0
    power[5, 30] = 7.0
    assert len(grid_peaks(power, 5, 0.5)) == 2


def test_tangent_basis_is_orthonormal_and_follows_the_angles():
    rng = np.random.default_rng(3)
    azimuth, elevation = rng.uniform(-3, 3, 50), rng.uniform(-1.4, 1.4, 50)
    u, step = unit_direction(azimuth, elevation), 1e-6
    B = tangent_basis(u)
    np.testing.assert_allclose(np.swapaxes(B, 1, 2) @ B, np.broadcast_to(np.eye(2), (50, 2, 2)), atol=1e-12)
    np.testing.assert_allclose((unit_direction(azimuth, elevation + step) - u) / step, B[:, :, 1], atol=1e-5)
    east = (unit_direction(azimuth + step, elevation) - u) / step / np.cos(elevation)[:, None]
    np.testing.assert_allclose(east, B[:, :, 0], atol=1e-5)
    np.testing.assert_allclose(np.stack(azimuth_elevation(u)), np.stack([azimuth, elevation]), atol=1e-12)


def test_a_grid_without_the_symmetries_is_refused():
    with pytest.raises(ValueError, match="even"):
        direction_grid(361, 181)
