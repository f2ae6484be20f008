"""The smallest error a direction can have (Cramér–Rao), written from the distances alone."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.aoa_simulation.links import WAVELENGTH_M
from mulan.wireless.directions import tangent_basis

_TURNS = 6


def phase_information(phase_noise_rad: float) -> float:
    """Fisher information [1/rad²] about the mean of a Gaussian phase known only within a turn.

    Below about half a radian it is 1/σ²; above, wrapping loses information that no estimator can use.
    """
    x = np.linspace(-np.pi, np.pi, 4001)
    turned = x[:, None] + 2 * np.pi * np.arange(-_TURNS, _TURNS + 1)
    density = np.exp(-0.5 * (turned / phase_noise_rad) ** 2)
    slope = -(turned / phase_noise_rad**2 * density).sum(1)
    total = density.sum(1)
    return float(np.trapezoid(slope**2 / np.maximum(total, 1e-300), x) / np.trapezoid(total, x))


def direction_bound(
    position_m: Float[NDArray, "n 3"],
    direction: Float[NDArray, "3"],
    range_m: float,
    phase_noise_rad: float,
) -> Float[NDArray, "2 2"]:
    """Cramér–Rao bound [rad²] over (azimuth, elevation); distance known, global phase not.

    The slope of the round-trip phase is a central difference of exact distances.
    """
    relative, step = position_m - position_m.mean(0), 1e-5

    def phase(u: Float[NDArray, "3"]) -> Float[NDArray, "n"]:
        source = range_m * u / np.linalg.norm(u)
        return -4 * np.pi / WAVELENGTH_M * np.linalg.norm(source - relative, axis=1)

    axes = tangent_basis(direction).T
    slope = np.stack(
        [(phase(direction + step * a) - phase(direction - step * a)) / (2 * step) for a in axes], 1
    )
    slope = slope - slope.mean(0)
    return np.linalg.inv(phase_information(phase_noise_rad) * slope.T @ slope)
