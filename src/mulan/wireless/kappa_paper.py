"""The paper's own AoA uncertainty, as a figure to compare with; never an angle."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.wireless.directions import unit_direction
from mulan.wireless.profile import bartlett_power, unit_sum_profile, wavenumber_rad_m
from mulan.wireless.types import AoaProfile


def kappa_paper(
    profile: AoaProfile,
    position_m: Float[NDArray, "n 3"],
    wavelength_m: float,
    tolerance_rad: float = 0.5,
    window_deg: float = 5.0,
    round_trip: bool = True,
    seed: int = 0,
) -> float:
    """``κ`` with ``1/κ = Σ_R F̄ F'`` (paper, "AoA uncertainty"; readings.md, row 4).

    F̄ is the measured profile and F' the one of a channel rebuilt from its top peak with phase noise ν, both
    of unit sum; R is the window about the peak, wrapping at ±180°. Lower means better; 1e4 to 5e6 on a
    one-degree grid, and dependent on its cell count.

    Args:
        profile: Measured, on a full grid.
        position_m: Antenna positions it was made from.
        wavelength_m: Carrier wavelength.
        tolerance_rad: Standard deviation of ν, which the paper sets to 0.5.
        window_deg: Half width of R in azimuth and elevation.
        round_trip: The channel was a forward x reverse product.
        seed: Of the noise ν.
    """
    rows, columns = profile.power.shape
    row, column = np.unravel_index(int(profile.power.argmax()), profile.power.shape)
    peak = unit_direction(profile.azimuth_rad[[column]], profile.elevation_rad[[row]])[0]
    noise_rad = tolerance_rad * np.random.default_rng(seed).normal(size=len(position_m))
    phase = wavenumber_rad_m(wavelength_m, round_trip) * (position_m - position_m.mean(0)) @ peak
    rebuilt = unit_sum_profile(
        bartlett_power(position_m, np.exp(1j * (phase + noise_rad)), wavelength_m, columns, rows, round_trip)
    )
    half_columns = round(window_deg / 360 * columns)
    half_rows = round(window_deg / 180 * (rows - 1))
    near_columns = np.arange(column - half_columns, column + half_columns + 1) % columns
    near_rows = np.arange(max(row - half_rows, 0), min(row + half_rows + 1, rows))
    window = np.ix_(near_rows, near_columns)
    overlap = np.sum(profile.power[window].astype(float) * rebuilt.power[window].astype(float))
    return float(1 / max(overlap, 1e-300))
