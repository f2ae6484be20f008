"""Bartlett power over all directions: the received angle-of-arrival profile of a synthetic aperture.

Sign convention: a channel is ``exp(-j 2π f d / c)``, so moving by p towards the source (unit direction u)
turns its phase by ``+k p·u``; k is 2π/λ for one-way CSI and 4π/λ for the product of both directions.
"""

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.angular_band import interpolated, sufficient_azimuths
from mulan.wireless.beamformer import beamformer_output
from mulan.wireless.directions import direction_grid, unit_direction
from mulan.wireless.types import AoaProfile

_WORTH_INTERPOLATING = 0.75  # of the azimuths wanted; above it, computing them all costs less


def wavenumber_rad_m(wavelength_m: float, round_trip: bool = True) -> float:
    """Phase per metre of displacement towards the source; doubled for forward x reverse products."""
    return (4.0 if round_trip else 2.0) * np.pi / wavelength_m


def bartlett_power_reference(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n *c"],
    wavelength_m: float,
    azimuth_rad: Float[NDArray, "a"],
    elevation_rad: Float[NDArray, "e"],
    round_trip: bool = True,
) -> Float[NDArray, "e a"]:
    """``Σ_c |Σ_k h_kc exp(-j k p_k·u)|²`` in complex128, straight from the definition (any grid; slow)."""
    channel = channel.reshape(len(channel), -1)
    relative = (position_m - position_m.mean(0)) * wavenumber_rad_m(wavelength_m, round_trip)
    power = np.empty((len(elevation_rad), len(azimuth_rad)))
    for row, elevation in enumerate(elevation_rad):
        u = unit_direction(azimuth_rad, np.full_like(azimuth_rad, elevation))
        power[row] = (np.abs(np.exp(-1j * (u @ relative.T)) @ channel) ** 2).sum(1)
    return power


def bartlett_power(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n *c"],
    wavelength_m: float,
    azimuth_count: int = 360,
    elevation_count: int = 181,
    round_trip: bool = True,
) -> Float[NDArray, "e a"]:
    """The reference's power on the full ``direction_grid`` in float32, to 1e-4 of its peak and far faster.

    Cost grows little with the number of packets, more with the path's height (``beamformer``), and falls with
    its radius (``angular_band``).

    Args:
        position_m: Antenna positions in the axes the grid refers to.
        channel: One complex number a position, or several (subcarriers, principal components): the powers
            of the columns are summed.
        wavelength_m: Carrier wavelength.
        azimuth_count: Even.
        elevation_count: Odd.
        round_trip: The channel is a forward x reverse product.
    """
    direction_grid(azimuth_count, elevation_count)
    middle = (position_m.min(0) + position_m.max(0)) / 2
    phase = (position_m - middle) * wavenumber_rad_m(wavelength_m, round_trip)
    count = sufficient_azimuths(float(np.linalg.norm(phase, axis=1).max()))
    one_step = azimuth_count == 2 * (elevation_count - 1) and azimuth_count % 4 == 0
    if one_step and count > _WORTH_INTERPOLATING * azimuth_count:
        count = azimuth_count
    power = np.zeros((elevation_count, azimuth_count), np.float32)
    for column in channel.reshape(len(channel), -1).T:
        output = beamformer_output(phase, column[:, None], count)
        if not one_step or count != azimuth_count:
            output = interpolated(output, azimuth_count, elevation_count)
        power += (output**2).sum((0, 1))
    return power


def unit_sum_profile(power: Float[NDArray, "e a"]) -> AoaProfile:
    """Power on a full ``direction_grid`` scaled to unit sum, the one scale-free form (readings.md, row 4)."""
    azimuth_rad, elevation_rad = direction_grid(power.shape[1], power.shape[0])
    return AoaProfile(azimuth_rad, elevation_rad, power / power.sum(dtype=np.float64).astype(power.dtype))
