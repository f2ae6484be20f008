"""Bartlett power on a full direction grid by the cheapest way to the accuracy; numpy and torch alike."""

from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.angular_band import interpolated, sufficient_azimuths
from mulan.wireless.beamformer import beamformer_output
from mulan.wireless.direct_steering import direct_output
from mulan.wireless.directions import direction_grid, unit_direction
from mulan.wireless.height_slices import height_shares
from mulan.wireless.principal_channels import principal_channels
from mulan.wireless.quadrant_steering import quadrant_output

_WORTH_INTERPOLATING = 0.75  # of the azimuths wanted; above it, computing them all costs less
_SLICE_COST, _SHARE_COST = 3.0, 0.035  # of a slice and of a packet in one, in packets of quadrant_output
_CHANNEL_COST = 0.05  # of a further channel in quadrant_output, in the same unit
_CHANNELS_AT_ONCE = 8  # bounds the memory


def _grid_directions(azimuth_count: int, elevation_count: int) -> Float[NDArray, "d 3"]:
    azimuth_rad, elevation_rad = direction_grid(azimuth_count, elevation_count)
    return unit_direction(*np.meshgrid(azimuth_rad, elevation_rad)).reshape(-1, 3)


def _plane_output(
    phase_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n c"],
    azimuth_count: int,
    xp: Any,
    device: str,
) -> Any:
    """Plane waves on a grid of one step, by whichever way costs less; as ``beamformer_output``."""
    slices, shares = height_shares(float(np.ptp(phase_m[:, 2])))
    packets, channels = channel.shape
    by_products = channels * (slices * _SLICE_COST + packets * shares * _SHARE_COST)
    if by_products < packets * (1 + (channels - 1) * _CHANNEL_COST):
        return beamformer_output(phase_m, channel, azimuth_count, xp, device)
    return quadrant_output(phase_m, channel, azimuth_count, xp, device)


def _grid_output(
    phase_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n c"],
    azimuth_count: int,
    elevation_count: int,
    range_rad: float | None,
    xp: Any,
    device: str,
) -> Any:
    """Beamformer output, real and imaginary parts [c, 2, elevation_count, azimuth_count]."""
    radius_rad = float(np.linalg.norm(phase_m, axis=1).max())
    if range_rad is not None:
        if radius_rad >= range_rad:
            raise ValueError("the range ends inside the aperture, where a source has no direction")
        radius_rad = radius_rad / (1 - radius_rad / range_rad)  # the phase's steepest slope over angle
    count = sufficient_azimuths(radius_rad)
    one_step = azimuth_count == 2 * (elevation_count - 1) and azimuth_count % 4 == 0
    if count > _WORTH_INTERPOLATING * azimuth_count:
        if one_step and range_rad is None:
            return _plane_output(phase_m, channel, azimuth_count, xp, device)
        if range_rad is not None or count > 2 * azimuth_count:
            directions = _grid_directions(azimuth_count, elevation_count)
            output = direct_output(phase_m, channel, directions, range_rad, xp, device)
            return output.reshape(-1, 2, elevation_count, azimuth_count)
    if range_rad is None:
        output = _plane_output(phase_m, channel, count, xp, device)
    else:
        directions = _grid_directions(count, count // 2 + 1)
        output = direct_output(phase_m, channel, directions, range_rad, xp, device)
        output = output.reshape(-1, 2, count // 2 + 1, count)
    return interpolated(output, azimuth_count, elevation_count, xp)


def grid_power(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n *c"],
    wavenumber_rad_m: float,
    azimuth_count: int,
    elevation_count: int,
    range_m: float | None,
    tolerance: float,
    xp: Any = np,
    device: str = "cpu",
) -> Any:
    """Power [elevation_count, azimuth_count], an array of the kind of ``xp``; see ``bartlett_power``."""
    direction_grid(azimuth_count, elevation_count)
    origin = position_m.mean(0)
    if range_m is None:
        origin = (position_m.min(0) + position_m.max(0)) / 2  # plane waves refer to no point
    phase_m = (position_m - origin) * wavenumber_rad_m
    range_rad = None if range_m is None else range_m * wavenumber_rad_m
    columns, column_power = principal_channels(channel.reshape(len(channel), -1))
    power = xp.zeros((elevation_count, azimuth_count), dtype=xp.float32, device=device)
    start, stop = 0, 1
    while start < stop:
        part = columns[:, start:stop]
        output = _grid_output(phase_m, part, azimuth_count, elevation_count, range_rad, xp, device)
        power += (output**2).sum((0, 1))
        worth = len(channel) * column_power > tolerance * float(power.max())
        start, stop = stop, min(stop + _CHANNELS_AT_ONCE, int(np.count_nonzero(worth)))
    return power
