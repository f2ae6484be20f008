"""The vertical part of a steering phase, spread over few horizontal slices.

``exp(-j z sin e)`` depends on a packet's height and on the elevation only. Written as a sum over slices of
(a real share of the packet) x (a function of the elevation), it leaves the horizontal part of the profile as
one matrix product a slice. Nearly level paths need one to nine Chebyshev terms (Jacobi-Anger expansion);
higher ones a grid of heights with a Kaiser-Bessel window, as in a non-uniform FFT (Beatty et al. 2005,
"Rapid gridding reconstruction with a minimal oversampling ratio").
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import i0, jv

_WINDOW_SLICES = 6  # with twofold oversampling: 1e-5 of the amplitude
_OVERSAMPLING = 2.0
_MOST_TERMS = 9
_LEAST_TERM = 2e-5


@dataclass(frozen=True)
class HeightSlice:
    """One term ``share · (even(sin e) - j odd(sin e))`` of ``exp(-j z sin e)``.

    Attributes:
        first, last: The packets it concerns, of those sorted by height: ``first <= k < last``.
        share: One factor each of these packets.
        even: Factor of every elevation, or None where it is zero.
        odd: The same for the part that changes sign below the horizon.
    """

    first: int
    last: int
    share: Float[NDArray, "m"]
    even: Float[NDArray, "e"] | None
    odd: Float[NDArray, "e"] | None


def _term_count(largest: float) -> int | None:
    """Chebyshev terms of heights up to ``largest`` in size, or None where slices are better."""
    size = np.abs(jv(np.arange(_MOST_TERMS + 1), largest))
    if largest >= _MOST_TERMS or size[-1] >= _LEAST_TERM:
        return None
    return max(1, int(np.count_nonzero(size > _LEAST_TERM)))


def height_shares(span_rad: float) -> tuple[int, int]:
    """How many slices ``height_slices`` makes of a span of heights, and how many share one packet."""
    terms = _term_count(span_rad / 2)
    if terms is not None:
        return terms, terms
    return int(span_rad * _OVERSAMPLING / np.pi) + _WINDOW_SLICES, _WINDOW_SLICES


def height_slices(height_rad: Float[NDArray, "n"], sin_elevation: Float[NDArray, "e"]) -> list[HeightSlice]:
    """The terms of ``exp(-j z sin e)``, to 5e-5.

    Args:
        height_rad: Heights z times the wavenumber, ascending, about the middle of their range.
        sin_elevation: Of the elevations wanted, in 0..1.
    """
    largest = float(np.abs(height_rad).max())
    terms = _term_count(largest)
    if terms is not None:
        return _chebyshev_terms(height_rad, largest, terms, sin_elevation)
    return _windowed_slices(height_rad, sin_elevation)


def _chebyshev_terms(
    height_rad: Float[NDArray, "n"], largest: float, terms: int, sin_elevation: Float[NDArray, "e"]
) -> list[HeightSlice]:
    angle = np.arccos(np.clip(height_rad / max(largest, 1e-30), -1.0, 1.0))
    found = []
    for m in range(terms):
        factor = (1 if m == 0 else 2) * (-1) ** (m // 2) * jv(m, largest * sin_elevation)
        even, odd = (factor, None) if m % 2 == 0 else (None, factor)
        found.append(HeightSlice(0, len(height_rad), np.cos(m * angle), even, odd))
    return found


def _windowed_slices(
    height_rad: Float[NDArray, "n"], sin_elevation: Float[NDArray, "e"]
) -> list[HeightSlice]:
    spacing, half = np.pi / _OVERSAMPLING, _WINDOW_SLICES / 2
    shape = np.pi * np.sqrt((_WINDOW_SLICES * (1 - 0.5 / _OVERSAMPLING)) ** 2 - 0.8)
    # the window's Fourier transform, by which the elevations are divided
    root = np.sqrt(shape**2 - (half * spacing * sin_elevation) ** 2)
    transform = _WINDOW_SLICES * np.sinh(root) / root
    lowest = np.ceil(height_rad[0] / spacing - half)
    highest = np.floor(height_rad[-1] / spacing + half)
    found = []
    for height in spacing * np.arange(lowest, highest + 1):
        first, last = np.searchsorted(height_rad, [height - half * spacing, height + half * spacing])
        if first == last:
            continue
        off = (height_rad[first:last] - height) / (half * spacing)
        share = i0(shape * np.sqrt(np.maximum(1 - off**2, 0.0)))
        even, odd = np.cos(height * sin_elevation) / transform, np.sin(height * sin_elevation) / transform
        found.append(HeightSlice(int(first), int(last), share, even, odd))
    return found
