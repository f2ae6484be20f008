"""The fast profile against the definition, over the paths and grids it must serve."""

import subprocess
import sys

import numpy as np
import pytest

from mulan.wireless.angular_band import sufficient_azimuths
from mulan.wireless.directions import direction_grid
from mulan.wireless.height_slices import height_slices
from mulan.wireless.principal_channels import principal_channels
from mulan.wireless.profile import (
    azimuth_power,
    bartlett_power,
    bartlett_power_reference,
    bartlett_powers,
    wavenumber_rad_m,
)

from .signals import WAVELENGTH_M

STATED_ERROR = 1e-4  # of the peak


def scattered(rng, n, extent_m):
    """Positions all over a box, with the channel of one source in noise."""
    position = rng.uniform(-0.5, 0.5, (n, 3)) * extent_m + [3.0, -1.0, 0.5]
    source = position.mean(0) + np.array([2.0, 3.0, 1.0])
    distance = np.linalg.norm(source - position, axis=1)
    noise = rng.normal(size=n) + 1j * rng.normal(size=n)
    return position, np.exp(-4j * np.pi * distance / WAVELENGTH_M) + 0.3 * noise


def error_of_peak(power, expected):
    return float(np.abs(power - expected).max() / expected.max())


@pytest.mark.parametrize("round_trip", [True, False])
@pytest.mark.parametrize(
    "extent_m",
    [
        (1.5, 1.5, 1.5),  # as high as wide
        (1.5, 1.5, 0.0),  # level
        (1.5, 0.4, 0.004),  # nearly level
        (0.4, 0.4, 0.02),  # between Chebyshev terms and slices
        (0.4, 0.4, 0.05),
        (0.0, 0.0, 1.0),  # a mast
        (0.02, 0.01, 0.0),  # hardly moved
    ],
)
def test_error_is_within_the_stated_bound_whatever_the_path(extent_m, round_trip):
    position, channel = scattered(np.random.default_rng(1), 40, np.array(extent_m))
    azimuth, elevation = direction_grid(360, 181)
    expected = bartlett_power_reference(position, channel, WAVELENGTH_M, azimuth, elevation[::6], round_trip)
    power = bartlett_power(position, channel, WAVELENGTH_M, round_trip=round_trip)
    assert error_of_peak(power[::6], expected) < STATED_ERROR


@pytest.mark.parametrize("grid", [(360, 181), (100, 41), (362, 181), (90, 61), (2, 3)])
@pytest.mark.parametrize("extent_m", [0.1, 0.5, 12.0])
def test_any_grid_and_any_size_of_path_is_served(grid, extent_m):
    position, channel = scattered(np.random.default_rng(2), 15, np.array([1.0, 0.8, 0.3]) * extent_m)
    azimuth, elevation = direction_grid(*grid)
    expected = bartlett_power_reference(position, channel, WAVELENGTH_M, azimuth, elevation)
    assert error_of_peak(bartlett_power(position, channel, WAVELENGTH_M, *grid), expected) < STATED_ERROR


def test_one_packet_has_the_same_power_everywhere():
    power = bartlett_power(np.array([[1.0, 2.0, 3.0]]), np.array([2.0 + 0j]), WAVELENGTH_M, 72, 37)
    np.testing.assert_allclose(power, 4.0, rtol=1e-5)


@pytest.mark.parametrize("round_trip", [True, False])
@pytest.mark.parametrize("extent_m", [0.15, 0.6])
def test_spherical_profile_equals_the_definition(extent_m, round_trip):
    position, channel = scattered(np.random.default_rng(3), 40, np.array([1.0, 1.0, 0.2]) * extent_m)
    azimuth, elevation = direction_grid(180, 91)
    options = (WAVELENGTH_M, azimuth, elevation, round_trip)
    expected = bartlett_power_reference(position, channel, *options, range_m=2.0)
    power = bartlett_power(position, channel, WAVELENGTH_M, 180, 91, round_trip, range_m=2.0)
    assert error_of_peak(power, expected) < STATED_ERROR
    plane = bartlett_power_reference(position, channel, *options)
    assert error_of_peak(plane, expected) > 10 * STATED_ERROR


def test_spherical_profile_peaks_at_a_near_source_where_the_plane_one_errs():
    rng = np.random.default_rng(4)
    errors = {True: [], False: []}
    for _ in range(8):
        position = rng.uniform(-0.5, 0.5, (80, 3)) * [1.2, 0.6, 0.3]
        centre = position.mean(0)
        azimuth, elevation = rng.uniform(-3, 3), rng.uniform(0, 0.6)
        true = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        distance = np.linalg.norm(centre + 3.0 * true - position, axis=1)
        channel = np.exp(-4j * np.pi * distance / WAVELENGTH_M)
        grid = direction_grid(360, 181)
        for spherical in errors:
            power = bartlett_power(position, channel, WAVELENGTH_M, range_m=3.0 if spherical else None)
            row, column = np.unravel_index(int(power.argmax()), power.shape)
            off = (grid[0][column] - azimuth + np.pi) % (2 * np.pi) - np.pi
            errors[spherical].append(np.hypot(off * np.cos(elevation), grid[1][row] - elevation))
    assert np.degrees(np.median(errors[True])) < 0.6  # half the diagonal of a grid cell
    assert np.median(errors[True]) < np.median(errors[False])


def test_a_range_inside_the_aperture_is_refused():
    position, channel = scattered(np.random.default_rng(5), 20, np.array([1.0, 1.0, 0.2]))
    with pytest.raises(ValueError, match="range"):
        bartlett_power(position, channel, WAVELENGTH_M, range_m=0.3)


def test_azimuth_profile_is_a_row_of_the_full_one():
    position, channel = scattered(np.random.default_rng(6), 50, np.array([0.5, 0.5, 0.1]))
    azimuth, elevation = direction_grid(360, 181)
    expected = bartlett_power_reference(position, channel, WAVELENGTH_M, azimuth, elevation[[100]])[0]
    row = azimuth_power(position, channel, WAVELENGTH_M, azimuth, elevation[100])
    assert error_of_peak(row, expected) < STATED_ERROR


def test_principal_channels_keep_the_summed_power():
    rng = np.random.default_rng(7)
    channel = rng.normal(size=(50, 8)) + 1j * rng.normal(size=(50, 8))
    channel[:, 5] = channel[:, :3] @ [1.0, 2j, -1.0]
    columns, power = principal_channels(channel)
    assert columns.shape == (50, 7)
    assert np.all(np.diff(power) <= 0)
    steering = rng.normal(size=(20, 50)) + 1j * rng.normal(size=(20, 50))
    expected = (np.abs(steering @ channel) ** 2).sum(1)
    np.testing.assert_allclose((np.abs(steering @ columns) ** 2).sum(1), expected, rtol=1e-10)


def test_alike_channels_lose_no_more_than_the_tolerance():
    rng = np.random.default_rng(8)
    position, channel = scattered(rng, 120, np.array([0.5, 0.5, 0.0]))
    noise = rng.normal(size=(120, 30)) + 1j * rng.normal(size=(120, 30))
    channels = channel[:, None] * np.exp(1j * rng.normal(size=30)) + 0.1 * noise
    azimuth, elevation = direction_grid(120, 61)
    expected = bartlett_power_reference(position, channels, WAVELENGTH_M, azimuth, elevation)
    for tolerance in (0.0, 1e-3, 1e-2):
        power = bartlett_power(position, channels, WAVELENGTH_M, 120, 61, tolerance=tolerance)
        assert error_of_peak(power, expected) < tolerance + STATED_ERROR


def test_silence_has_no_power():
    position, _ = scattered(np.random.default_rng(9), 20, np.array([0.5, 0.5, 0.1]))
    assert not bartlett_power(position, np.zeros((20, 3), complex), WAVELENGTH_M, 72, 37).any()


def test_links_of_a_batch_are_profiled_as_they_are_asked_for():
    rng = np.random.default_rng(10)
    links = [scattered(rng, n, np.array([0.3, 0.3, 0.05])) for n in (30, 60)]

    def recorded():
        yield from links
        raise AssertionError("nobody asked for a third link")

    powers = bartlett_powers(recorded(), WAVELENGTH_M, 72, 37)
    for position, channel in links:
        np.testing.assert_array_equal(next(powers), bartlett_power(position, channel, WAVELENGTH_M, 72, 37))


@pytest.mark.parametrize("range_m", [None, 2.0])
def test_torch_gives_the_same_profile(range_m):
    from mulan.wireless.profile_torch import bartlett_power_torch

    rng = np.random.default_rng(11)
    position, channel = scattered(rng, 60, np.array([0.4, 0.4, 0.1]))
    channels = np.stack([channel, channel * 1j + 0.1 * rng.normal(size=60)], 1)
    expected = bartlett_power(position, channels, WAVELENGTH_M, 120, 61, range_m=range_m)
    power = bartlett_power_torch(position, channels, WAVELENGTH_M, 120, 61, range_m=range_m)
    assert error_of_peak(power.numpy(), expected) < 1e-5


def test_the_radio_does_not_load_torch():
    code = "import sys, mulan.wireless.profile; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_height_terms_sum_to_the_exponential():
    sin_elevation = np.sin(np.linspace(0, np.pi / 2, 31))
    for spread in (0.0, 1e-6, 0.3, 1.0, 2.0, 5.0, 40.0, 200.0):
        height = np.sort(np.random.default_rng(12).uniform(-spread, spread, 50))
        total = np.zeros((50, 31), complex)
        for part in height_slices(height, sin_elevation):
            even = 0.0 if part.even is None else part.even
            odd = 0.0 if part.odd is None else part.odd
            total[part.first : part.last] += np.outer(part.share, even - 1j * odd)
        np.testing.assert_allclose(total, np.exp(-1j * np.outer(height, sin_elevation)), atol=2e-5)


def test_the_band_holds_all_of_an_aperture():
    azimuth = np.linspace(-np.pi, np.pi, 4096, endpoint=False)
    for radius_rad in (0.0, 1.0, 20.0, 90.0, 250.0):
        spectrum = np.abs(np.fft.fft(np.exp(1j * radius_rad * np.cos(azimuth)))) / 4096
        half = sufficient_azimuths(radius_rad) // 2
        assert spectrum[half : 4096 - half].max() < 1e-5
    assert wavenumber_rad_m(0.05) == pytest.approx(2 * wavenumber_rad_m(0.05, round_trip=False))
