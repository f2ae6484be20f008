"""Beamformer output over a whole grid of directions, by matrix products instead of exponentials.

With azimuth a, elevation e and a level position (x, y), ``2 cos e (x cos a + y sin a)`` is
``x cos α + y sin α`` at α = a + e plus the same at β = a - e. On a grid with one step in both angles α and β
lie on that grid too. Steering is then a product g(α) g(β), and the sum over packets a matrix product with
one exponential a packet and grid angle. α and β are both even or both odd multiples of the step, and half a
turn conjugates g, so cosines and sines over half a turn serve. What height adds is in ``height_slices``.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from mulan.wireless.height_slices import HeightSlice, height_slices

_ROWS_AT_ONCE = 48  # products commute: two blocks of rows save a quarter of the work


@dataclass(frozen=True)
class _Lattice:
    """Where each direction is among the products; q = azimuths / 4.

    Attributes:
        angle_rad: α at even and odd multiples of the step, over half a turn.
        sin_elevation: From the horizon to the zenith.
        place: Into the flat [half turns, conjugated, hemisphere, parity, i, j], of all directions.
    """

    angle_rad: Float[NDArray, "2 q"]
    sin_elevation: Float[NDArray, "e"]
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
    # only products of j <= i are there; they commute, up to which of both is conjugated
    conjugated = np.where(i < j, half_alpha, half_beta)
    place = (half_alpha != half_beta) * 2 + conjugated
    for size, index in ((2, row < 0), (2, alpha % 2), (q, np.maximum(i, j)), (q, np.minimum(i, j))):
        place = place * size + index
    step = 2 * np.pi / n
    angle_rad = step * np.arange(n // 2).reshape(q, 2).T
    return _Lattice(angle_rad, np.sin(step * np.arange(q + 1)), place)


def _by_distance(
    slices: list[HeightSlice], first: int, last: int
) -> Float[NDArray, "slices parts complement m q"]:
    """Factors of all slices for first <= i < last and j < last, a view of few numbers.

    They are even and odd parts at the elevation |i - j| or, half a turn between α and β, its complement.
    """
    count = len(next(f for f in (slices[0].even, slices[0].odd) if f is not None))
    factor = np.zeros((len(slices), 2, 2, count), np.float32)
    for row, part in enumerate(slices):
        for parity, by_elevation in enumerate((part.even, part.odd)):
            if by_elevation is not None:
                factor[row, parity] = by_elevation, by_elevation[::-1]
    both_ways = np.concatenate([factor[..., last - 1 : 0 : -1], factor[..., :last]], -1)
    return np.lib.stride_tricks.sliding_window_view(both_ways, last, -1)[..., ::-1, :][..., first:last, :]


def _slice_sums(
    trig: Any, channel: Complex[NDArray, "n"], slices: list[HeightSlice], first: int, last: int, xp: Any
) -> Any:
    """Sums over packets for angles i in first..last and j < last.

    Returns:
        [parts even and odd in elevation, 4 sums, parity, (real, imaginary), i, j]; the sums are
        cos cos - sin sin, cos sin + sin cos, cos cos + sin sin, cos sin - sin cos of i and j.
    """
    rows, device = last - first, trig.device

    def empty(*shape: int) -> Any:
        return xp.empty(shape, dtype=xp.float32, device=device)

    def single(array: NDArray) -> Any:
        return xp.asarray(np.ascontiguousarray(array, np.float32), device=device)

    # buffers reused by all slices: fresh memory for each would cost more than the arithmetic
    total = xp.zeros((2, 4, 2, 2, rows, last), dtype=xp.float32, device=device)
    weighted_columns = empty(2, 2, 2, last, max(part.last - part.first for part in slices))
    products, terms = empty(2, 2, 2, 2 * rows, last), empty(4, 2, 2, rows, last)
    scaled = empty(2, 2, 2, rows, last)
    left = trig[:, :, first:last].reshape(2, 1, 1, 2 * rows, -1)
    factors = _by_distance(slices, first, last)
    for part, factor in zip(slices, factors, strict=True):
        packets = slice(part.first, part.last)
        weight = channel[packets] * part.share
        columns = trig[:, :, :last, packets]
        weighted = weighted_columns[..., : part.last - part.first]
        xp.multiply(columns, single(np.real(weight)), out=weighted[:, :, 0])
        xp.multiply(columns, single(np.imag(weight)), out=weighted[:, :, 1])
        xp.matmul(left[..., packets], weighted.swapaxes(-1, -2), out=products)
        cos_cos, sin_cos = products[:, 0, :, :rows], products[:, 0, :, rows:]
        cos_sin, sin_sin = products[:, 1, :, :rows], products[:, 1, :, rows:]
        xp.subtract(cos_cos, sin_sin, out=terms[0])
        xp.add(cos_sin, sin_cos, out=terms[1])
        xp.add(cos_cos, sin_sin, out=terms[2])
        xp.subtract(cos_sin, sin_cos, out=terms[3])
        for parity, by_elevation in enumerate((part.even, part.odd)):
            if by_elevation is None:
                continue
            for complement, pair in enumerate((slice(0, 2), slice(2, 4))):
                xp.multiply(terms[pair], single(factor[parity, complement]), out=scaled)
                total[parity, pair] += scaled
    return total


def beamformer_output(
    phase_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n c"],
    azimuth_count: int,
    xp: Any = np,
    device: str = "cpu",
) -> Any:
    """``Σ_k h_kc exp(-j p_k·u)`` in single precision, to 5e-5 of ``Σ_k |h_kc|``.

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
    turn = np.stack([np.cos(lattice.angle_rad), np.sin(lattice.angle_rad)], -1) / 2
    angle = xp.asarray((turn @ phase_m[:, :2].T).astype(np.float32), device=device)
    trig = xp.stack([xp.cos(angle), xp.sin(angle)], 1)  # [parity, (cos, sin), q, n]
    place = xp.asarray(lattice.place, device=device)
    slices = height_slices(phase_m[:, 2], lattice.sin_elevation)
    blocks = 1 if device != "cpu" else max(1, round(q / _ROWS_AT_ONCE))
    edges = [q * block // blocks for block in range(blocks + 1)]
    found = []
    for h in channel.T:
        total = xp.zeros((2, 4, 2, 2, q, q), dtype=xp.float32, device=device)
        for first, last in pairwise(edges):
            total[..., first:last, :last] = _slice_sums(trig, h, slices, first, last, xp)
        field = _directions_of_sums(total, xp).reshape(-1)[place]
        found.append(xp.stack([field.real, field.imag]))
    return xp.stack(found)


def _directions_of_sums(total: Any, xp: Any) -> Any:
    """From the sums for j <= i to the output as ``_Lattice.place`` numbers it."""
    level, tilted = total[:, :, :, 0] + 1j * total[:, :, :, 1]
    output = []
    for half_turns in (0, 2):
        for j in (-1j, 1j):
            upright = level[half_turns] + j * level[half_turns + 1]
            slanted = 1j * (tilted[half_turns] + j * tilted[half_turns + 1])
            output += [upright - slanted, upright + slanted]
    return xp.stack(output)
