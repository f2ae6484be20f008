"""The profile by torch, on any of its devices; the mathematics is that of ``profile``."""

import torch
from jaxtyping import Complex, Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.wireless.grid_power import grid_power
from mulan.wireless.profile import wavenumber_rad_m


def bartlett_power_torch(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n *c"],
    wavelength_m: float,
    azimuth_count: int = 360,
    elevation_count: int = 181,
    round_trip: bool = True,
    range_m: float | None = None,
    tolerance: float = 1e-2,
    device: str = "cpu",
) -> Float[Tensor, "e a"]:
    """``profile.bartlett_power`` on a torch device, where the result stays."""
    k = wavenumber_rad_m(wavelength_m, round_trip)
    return grid_power(
        position_m, channel, k, azimuth_count, elevation_count, range_m, tolerance, torch, device
    )
