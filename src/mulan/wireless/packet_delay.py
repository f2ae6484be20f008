"""The delay of each packet, which packet detection makes random, taken out of its channel."""

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

_MAX_DELAY_S = 400e-9  # packet detection jitter is a few 50 ns samples
_DELAY_STEP_S = 10e-9  # a sixth of a 20 MHz band's resolution, so Newton starts on the main lobe


def band_centre_hz(subcarrier_hz: Float[NDArray, "s"]) -> float:
    """Middle of the band (the carrier, for a symmetric grouping)."""
    return float(subcarrier_hz.min() + subcarrier_hz.max()) / 2


def freed_of_delay(
    channel: Complex[NDArray, "n s"], subcarrier_hz: Float[NDArray, "s"]
) -> Complex[NDArray, "n s"]:
    """Each packet's channel with its linear phase over the subcarriers removed about the band centre.

    The delay is the one with the strongest coherent sum (a search and two Newton steps), so no phase is ever
    unwrapped. What differs between subcarriers afterwards is multipath and noise.
    """
    offset = 2 * np.pi * (subcarrier_hz - band_centre_hz(subcarrier_hz))
    delays = np.arange(-_MAX_DELAY_S, _MAX_DELAY_S + _DELAY_STEP_S / 2, _DELAY_STEP_S)
    spectrum = np.abs(channel @ np.exp(1j * np.outer(offset, delays)))
    delay = delays[spectrum.argmax(1)]
    for _ in range(2):
        turned = channel * np.exp(1j * np.outer(delay, offset))
        total, first, second = turned.sum(1), turned @ (1j * offset), turned @ (-(offset**2))
        slope = 2 * (first * total.conj()).real
        curvature = 2 * ((second * total.conj()).real + np.abs(first) ** 2)
        step = np.where(curvature < 0, -slope / np.where(curvature < 0, curvature, -1.0), 0.0)
        delay = delay + np.clip(step, -_DELAY_STEP_S, _DELAY_STEP_S)
    return channel * np.exp(1j * np.outer(delay, offset))


def channel_at_centre(
    channel: Complex[NDArray, "n s"], subcarrier_hz: Float[NDArray, "s"]
) -> Complex[NDArray, "n"]:
    """Each packet's channel at the band centre: the average over subcarriers freed of the delay."""
    return freed_of_delay(channel, subcarrier_hz).mean(1)
