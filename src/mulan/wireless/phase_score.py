"""The last step of a direction among strong phase noise: from the coherent sum's peak to maximum likelihood.

The coherent sum weighs a phase off by θ with sin θ, which is best for little noise. Beyond half a radian a
Gaussian phase known only within a turn asks for its own score; one step of Fisher scoring from the peak takes
the 5 % that are left (docs/wireless.md).
"""

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.directions import tangent_basis
from mulan.wireless.peak import SteeringModel
from mulan.wireless.uncertainty import is_level

_LEAST_NOISE_RAD = 0.5  # below it both agree within half a percent
_MOST_NOISE_RAD = 2.0  # beyond it the phases tell too little to estimate the noise from them
_LONGEST_STEP_RAD = 0.02  # a step this long leaves the peak it should polish
_TURNS = 2 * np.pi * np.arange(-4, 5)


def _score(off_rad: Float[NDArray, "n"], noise_rad: float) -> Float[NDArray, "n"]:
    """Minus the derivative of the log density of a wrapped Gaussian."""
    turned = off_rad[:, None] + _TURNS
    density = np.exp(-0.5 * (turned / noise_rad) ** 2)
    return (turned * density).sum(1) / density.sum(1) / noise_rad**2


def _information(noise_rad: float) -> float:
    """Fisher information [1/rad²] of one phase about its mean."""
    off = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    density = np.exp(-0.5 * ((off[:, None] + _TURNS) / noise_rad) ** 2).sum(1)
    return float((_score(off, noise_rad) ** 2 * density).sum() / density.sum())


def scored_direction(
    model: SteeringModel, channel: Complex[NDArray, "n"], direction: Float[NDArray, "3"]
) -> Float[NDArray, "3"]:
    """One Fisher scoring step from a refined peak, packets weighted by their amplitude.

    Args:
        model: Steering.
        channel: One complex number a packet, whose phase noise is white.
        direction: The refined maximum of the coherent sum.

    Returns:
        The better direction, or the same where there is too little or too much noise to gain.
    """
    turned = model.turned_back(channel, direction)
    total = turned.sum()
    amplitude = np.abs(channel)
    coherence2 = (np.abs(total) / amplitude.sum()) ** 2
    # chance and the three fitted parameters alone make a sum of n random phases this coherent
    coherence2 = (coherence2 - 1.5 / len(channel)) / (1 - 1.5 / len(channel))
    if coherence2 <= np.exp(-(_MOST_NOISE_RAD**2)) or coherence2 >= np.exp(-(_LEAST_NOISE_RAD**2)):
        return direction
    noise_rad = float(np.sqrt(-np.log(coherence2)))
    axes = 1 if is_level(model) else 2
    J = np.column_stack([model.jacobian(direction)[:, :axes], np.ones(len(channel))])
    weighted = J * amplitude[:, None]
    score = _score(np.angle(turned * np.exp(-1j * np.angle(total))), noise_rad)
    step = np.linalg.lstsq(weighted.T @ J, weighted.T @ score, rcond=None)[0] / _information(noise_rad)
    if np.linalg.norm(step[:axes]) > _LONGEST_STEP_RAD:
        return direction
    better = direction + tangent_basis(direction)[:, :axes] @ step[:axes]
    return better / np.linalg.norm(better)
