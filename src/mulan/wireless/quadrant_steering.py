"""Beamformer output over a whole grid of directions, one exponential for each four of them.

The horizontal part of the phase flips sign half a turn away and is the same above and below the horizon. For
few packets on a high path this costs less than the many slices of ``beamformer``.
"""

from typing import Any

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

_PACKETS_PER_BLOCK = 192  # 192 x 180 float32, three times over, stays inside a 1 MiB L2 cache


def quadrant_output(
    phase_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n c"],
    azimuth_count: int,
    xp: Any = np,
    device: str = "cpu",
) -> Any:
    """The same as ``beamformer.beamformer_output``, exact to single precision."""
    half, quarter = azimuth_count // 2, azimuth_count // 4
    count, packets = channel.shape[1], len(channel)
    step = 2 * np.pi / azimuth_count

    def single(array: NDArray) -> Any:
        return xp.asarray(np.ascontiguousarray(array, np.float32), device=device)

    azimuth_rad, upper_rad = -np.pi + step * np.arange(half), step * np.arange(quarter + 1)
    in_plane = single(phase_m[:, :2] @ np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)]))
    rise = np.exp(-1j * np.outer(np.sin(upper_rad), phase_m[:, 2])).astype(np.complex64)
    columns = np.ascontiguousarray(channel.T, np.complex64)
    cos_sum = xp.zeros((quarter + 1, 4 * count, half), dtype=xp.float32, device=device)
    sin_sum = xp.zeros((quarter + 1, 4 * count, half), dtype=xp.float32, device=device)
    together = packets if device != "cpu" else _PACKETS_PER_BLOCK
    for start in range(0, packets, together):
        block = in_plane[start : start + together]
        angle, trig = xp.empty_like(block), xp.empty_like(block)
        for row, cos_elevation in enumerate(np.cos(upper_rad)):
            above = columns[:, start : start + together] * rise[row, start : start + together]
            below = columns[:, start : start + together] * rise[row, start : start + together].conj()
            weight = single(np.concatenate([above.real, above.imag, below.real, below.imag]))
            xp.multiply(block, float(cos_elevation), out=angle)
            cos_sum[row] += weight @ xp.cos(angle, out=trig)
            sin_sum[row] += weight @ xp.sin(angle, out=trig)
    hemispheres = []
    for upper in (True, False):
        first = 0 if upper else 2 * count
        re, im = slice(first, first + count), slice(first + count, first + 2 * count)
        here = [cos_sum[:, re] + sin_sum[:, im], cos_sum[:, im] - sin_sum[:, re]]
        across = [cos_sum[:, re] - sin_sum[:, im], cos_sum[:, im] + sin_sum[:, re]]
        # [elevation, c, (real, imaginary), azimuth]
        hemispheres.append(xp.concatenate([xp.stack(here, 2), xp.stack(across, 2)], -1))
    rows = xp.concatenate([xp.flip(hemispheres[1][1:], (0,)), hemispheres[0]])
    return xp.moveaxis(rows, 0, 2)
