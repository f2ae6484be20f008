"""Bartlett power over all directions: the received angle-of-arrival profile of a synthetic aperture.

Sign convention: a channel is ``exp(-j 2π f d / c)``, so moving by p towards the source (unit direction u)
turns its phase by ``+k p·u``; k is 2π/λ for one-way CSI and 4π/λ for the product of both directions.
"""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.direct_steering import direct_output
from mulan.wireless.directions import direction_grid, unit_direction
from mulan.wireless.grid_power import grid_power
from mulan.wireless.types import AoaProfile


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
    range_m: float | None = None,
) -> Float[NDArray, "e a"]:
    """``Σ_c |Σ_k h_kc exp(-jφ_k(u))|²`` in complex128, straight from the definition (any grid; slow).

    φ is ``k p·u`` for plane waves and ``k (r - |r u - p|)`` for a source at range r from the centroid.
    """
    channel = channel.reshape(len(channel), -1)
    k, relative = wavenumber_rad_m(wavelength_m, round_trip), position_m - position_m.mean(0)
    power = np.empty((len(elevation_rad), len(azimuth_rad)))
    for row, elevation in enumerate(elevation_rad):
        u = unit_direction(azimuth_rad, np.full_like(azimuth_rad, elevation))
        if range_m is None:
            towards_m = u @ relative.T
        else:
            towards_m = range_m - np.linalg.norm(range_m * u[:, None] - relative, axis=2)
        power[row] = (np.abs(np.exp(-1j * k * towards_m) @ channel) ** 2).sum(1)
    return power


def bartlett_power(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n *c"],
    wavelength_m: float,
    azimuth_count: int = 360,
    elevation_count: int = 181,
    round_trip: bool = True,
    range_m: float | None = None,
    tolerance: float = 1e-2,
) -> Float[NDArray, "e a"]:
    """The reference's power on the full ``direction_grid`` in float32, to 1e-4 of its peak and far faster.

    For plane waves the cost grows little with the number of packets, more with the path's height
    (``beamformer``), and falls with its radius (``angular_band``). Spherical waves cost more.

    Args:
        position_m: Antenna positions in the axes the grid refers to.
        channel: One complex number a position, or several (subcarriers, principal components): the powers
            of the columns are summed.
        wavelength_m: Carrier wavelength.
        azimuth_count: Even.
        elevation_count: Odd.
        round_trip: The channel is a forward x reverse product.
        range_m: Distance of the source from the centroid of the positions, beyond all of them, for spherical
            waves; None for plane waves.
        tolerance: Share of the peak that several columns may lose at most, by leaving out their weakest
            principal components; recorded links (30 subcarriers) lose less than a tenth of that.

    Raises:
        ValueError: A grid without the symmetries, or a range that does not leave the aperture.
    """
    k = wavenumber_rad_m(wavelength_m, round_trip)
    return grid_power(position_m, channel, k, azimuth_count, elevation_count, range_m, tolerance)


def bartlett_powers(
    links: Iterable[tuple[Float[NDArray, "n 3"], Complex[NDArray, "n *c"]]],
    wavelength_m: float,
    azimuth_count: int = 360,
    elevation_count: int = 181,
    round_trip: bool = True,
) -> Iterator[Float[NDArray, "e a"]]:
    """``bartlett_power`` of many links (positions, channel), one after the other as they are asked for.

    Nothing of a link is kept after its turn, so memory does not grow with their number.
    """
    for position_m, channel in links:
        yield bartlett_power(position_m, channel, wavelength_m, azimuth_count, elevation_count, round_trip)


def azimuth_power(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n *c"],
    wavelength_m: float,
    azimuth_rad: Float[NDArray, "a"],
    elevation_rad: float = 0.0,
    round_trip: bool = True,
    range_m: float | None = None,
) -> Float[NDArray, "a"]:
    """The two-dimensional profile: power over any azimuths at one elevation, in float32 to 1e-4 of its peak.

    Arguments as for ``bartlett_power``.
    """
    k = wavenumber_rad_m(wavelength_m, round_trip)
    directions = unit_direction(azimuth_rad, np.full_like(azimuth_rad, elevation_rad))
    columns = channel.reshape(len(channel), -1)
    range_rad = None if range_m is None else k * range_m
    output = direct_output((position_m - position_m.mean(0)) * k, columns, directions, range_rad)
    return (output**2).sum((0, 1))


def unit_sum_profile(power: Float[NDArray, "e a"]) -> AoaProfile:
    """Power on a full ``direction_grid`` scaled to unit sum, the one scale-free form (readings.md, row 4)."""
    azimuth_rad, elevation_rad = direction_grid(power.shape[1], power.shape[0])
    return AoaProfile(azimuth_rad, elevation_rad, power / power.sum(dtype=np.float64).astype(power.dtype))
