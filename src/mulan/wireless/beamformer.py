"""Beamformer output over a whole grid of directions, by matrix products instead of exponentials.

With azimuth a, elevation e and a level position (x, y), ``2 cos e (x cos a + y sin a)`` is
``x cos α + y sin α`` at α = a + e plus the same at β = a - e. On a grid with one step in both angles α and β
lie on that grid too. Steering is then a product g(α) g(β), and the sum over packets a matrix product with
one exponential a packet and grid angle. α and β are both even or both odd multiples of the step, and half a
turn conjugates g, so cosines and sines over half a turn serve. What height adds is in ``height_slices``.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from mulan.wireless.height_slices import height_slices


@dataclass(frozen=True)
class _Lattice:
    """Where each direction is among the products; q = azimuths / 4.

    Attributes:
        angle_rad: α of both parities over half a turn.
        sin_elevation: From the horizon to the zenith.
        apart: |i - j|, the elevation's index, of products of angles i and j.
        place: Into the flat [half turns, conjugated, hemisphere, parity, i, j], of all directions.
    """

    angle_rad: Float[NDArray, "2 q"]
    sin_elevation: Float[NDArray, "e"]
    apart: Int[NDArray, "q q"]
    place: Int[NDArray, "rows columns"]


@lru_cache(maxsize=8)
def _lattice(azimuth_count: int) -> _Lattice:
    n, q = azimuth_count, azimuth_count // 4
    row, column = np.arange(-q, q + 1)[:, None], np.arange(n)[None] - n // 2
    above = np.abs(row)
    # below the horizon α and β change places, which changes nothing in a level plane
    alpha, beta = (column + above) % n, (column - above) % n
    half_alpha, i = np.divmod(alpha // 2, q)
    half_beta, j = np.divmod(beta // 2, q)
    place = (half_alpha != half_beta) * 2 + half_beta
    for size, index in ((2, row < 0), (2, alpha % 2), (q, i), (q, j)):
        place = place * size + index
    step = 2 * np.pi / n
    angle_rad = step * np.arange(n // 2).reshape(q, 2).T
    apart = np.abs(np.arange(q)[:, None] - np.arange(q)[None])
    return _Lattice(angle_rad, np.sin(step * np.arange(q + 1)), apart, place)


def beamformer_output(
    phase_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n c"],
    azimuth_count: int,
    xp: Any = np,
    device: str = "cpu",
) -> Any:
    """``Σ_k h_kc exp(-j p_k·u)`` in single precision, to 1e-5 of ``Σ_k |h_kc|``.

    Args:
        phase_m: Positions times the wavenumber, about the middle of their range.
        channel: Columns are treated alike.
        azimuth_count: Divisible by four; elevations have the same step, from pole to pole.
        xp: numpy or torch, whose arrays do the work.
        device: Where torch does it.

    Returns:
        Real and imaginary parts, [c, 2, azimuth_count / 2 + 1, azimuth_count], of the kind of ``xp``.
    """
    lattice, q = _lattice(azimuth_count), azimuth_count // 4
    order = np.argsort(phase_m[:, 2], kind="stable")
    phase_m, channel = phase_m[order], channel[order]

    def on_device(array: NDArray) -> Any:
        return xp.asarray(array, device=device)

    def single(array: NDArray) -> Any:
        return on_device(np.ascontiguousarray(array, np.float32))

    turn = np.stack([np.cos(lattice.angle_rad), np.sin(lattice.angle_rad)], -1) / 2
    angle = single(turn @ phase_m[:, :2].T)
    trig = xp.concatenate([xp.cos(angle), xp.sin(angle)], 1)  # [parity, (cos, sin) x q, n]
    apart = on_device(lattice.apart)
    place = on_device(lattice.place)
    slices = height_slices(phase_m[:, 2], lattice.sin_elevation)
    found = []
    for h in channel.T:
        # [4 sums, parity, i, real and imaginary, j], of the parts even and odd in elevation
        level, tilted = xp.zeros((2, 4, 2, q, 2, q), dtype=xp.float32, device=device)
        for part in slices:
            weight = h[part.first : part.last] * part.share
            columns = trig[:, :, part.first : part.last]
            weighted = xp.concatenate([columns * single(weight.real), columns * single(weight.imag)], 1)
            sums = (columns @ weighted.swapaxes(1, 2)).reshape(2, 2, q, 2, 2, q)
            cos_cos, cos_sin = sums[:, 0, :, :, 0], sums[:, 0, :, :, 1]
            sin_cos, sin_sin = sums[:, 1, :, :, 0], sums[:, 1, :, :, 1]
            terms = xp.stack([cos_cos - sin_sin, cos_sin + sin_cos, cos_cos + sin_sin, cos_sin - sin_cos])
            for factor, total in ((part.even, level), (part.odd, tilted)):
                if factor is None:
                    continue
                # half a turn between α and β makes the elevation its complement
                total[:2] += terms[:2] * single(factor)[apart][:, None]
                total[2:] += terms[2:] * single(factor[::-1])[apart][:, None]
        level, tilted = (total[:, :, :, 0] + 1j * total[:, :, :, 1] for total in (level, tilted))
        output = []
        for half_turns in (0, 2):
            for j in (-1j, 1j):
                upright = level[half_turns] + j * level[half_turns + 1]
                slanted = 1j * (tilted[half_turns] + j * tilted[half_turns + 1])
                output += [upright - slanted, upright + slanted]
        field = xp.stack(output).reshape(-1)[place]
        found.append(xp.stack([field.real, field.imag]))
    return xp.stack(found)
