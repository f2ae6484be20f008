"""Bartlett power over all directions: the received angle-of-arrival profile of a synthetic aperture.

Sign convention: a channel is ``exp(-j 2π f d / c)``, so moving by p towards the source (unit direction u)
turns its phase by ``+k p·u``; k is 2π/λ for one-way CSI and 4π/λ for the product of both directions.
"""

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.directions import direction_grid, unit_direction
from mulan.wireless.types import AoaProfile

_PACKETS_PER_BLOCK = 192  # 192 x 180 float32, three times over, stays inside a 1 MiB L2 cache


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
    """The reference's power on the full ``direction_grid`` in float32, about a hundred times faster.

    The horizontal part of the phase flips sign half a turn away and is the same above and below the horizon,
    so one sine and cosine serve four directions.

    Args:
        position_m: Antenna positions in the axes the grid refers to.
        channel: One complex number a position, or several (subcarriers, principal components): the powers
            of the columns are summed.
        wavelength_m: Carrier wavelength.
        azimuth_count: Even.
        elevation_count: Odd.
        round_trip: The channel is a forward x reverse product.
    """
    azimuth_rad, elevation_rad = direction_grid(azimuth_count, elevation_count)
    k = wavenumber_rad_m(wavelength_m, round_trip)
    relative = (position_m - position_m.mean(0)) * k
    half, middle = azimuth_count // 2, elevation_count // 2
    steering = np.stack([np.cos(azimuth_rad[:half]), np.sin(azimuth_rad[:half])])
    in_plane = (relative[:, :2] @ steering).astype(np.float32)
    upper = elevation_rad[middle:]
    rise = np.exp(-1j * np.outer(np.sin(upper), relative[:, 2]))
    columns = channel.reshape(len(channel), -1).T
    above, below = columns * rise[:, None], columns * rise.conj()[:, None]
    weights = np.stack([np.real(above), np.imag(above), np.real(below), np.imag(below)], 1)
    weights = weights.astype(np.float32).reshape(len(upper), -1, len(channel))
    cos_sum = np.zeros((*weights.shape[:2], half), np.float32)
    sin_sum = np.zeros_like(cos_sum)
    for start in range(0, len(channel), _PACKETS_PER_BLOCK):
        block = np.ascontiguousarray(in_plane[start : start + _PACKETS_PER_BLOCK])
        angle, trig = np.empty_like(block), np.empty_like(block)
        for row, cos_elevation in enumerate(np.cos(upper).astype(np.float32)):
            w = weights[row, :, start : start + _PACKETS_PER_BLOCK]
            np.multiply(block, cos_elevation, out=angle)
            cos_sum[row] += w @ np.cos(angle, out=trig)
            sin_sum[row] += w @ np.sin(angle, out=trig)
    cos_sum = cos_sum.reshape(len(upper), 4, -1, half)
    sin_sum = sin_sum.reshape(cos_sum.shape)
    power = np.empty((elevation_count, azimuth_count), np.float32)
    for real, rows in ((0, np.arange(middle, elevation_count)), (2, np.arange(middle, -1, -1))):
        re_cos, im_cos = cos_sum[:, real], cos_sum[:, real + 1]
        re_sin, im_sin = sin_sum[:, real], sin_sum[:, real + 1]
        power[rows, :half] = ((re_cos + im_sin) ** 2 + (im_cos - re_sin) ** 2).sum(1)
        power[rows, half:] = ((re_cos - im_sin) ** 2 + (im_cos + re_sin) ** 2).sum(1)
    return power


def unit_sum_profile(power: Float[NDArray, "e a"]) -> AoaProfile:
    """Power on a full ``direction_grid`` scaled to unit sum, the one scale-free form (readings.md, row 4)."""
    azimuth_rad, elevation_rad = direction_grid(power.shape[1], power.shape[0])
    return AoaProfile(azimuth_rad, elevation_rad, power / power.sum(dtype=np.float64).astype(power.dtype))
