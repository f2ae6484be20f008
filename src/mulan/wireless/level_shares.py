"""How much of a channel one source level with the path explains, over azimuth, distance and path scale."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.principal_channels import principal_channels
from mulan.wireless.profile import wavenumber_rad_m

_CHANNELS = 3  # principal components of the subcarriers kept; on real cards they hold 98 % of the power
_SPARE_HARMONICS = 12  # beyond k·radius the amplitude's harmonics fall off faster than exponentially


@dataclass(frozen=True)
class LevelShares:
    """Share of the power a single source explains, 0..1.

    Attributes:
        share: Over curvature, scale and azimuth.
        curvature_per_m: One over the source's distance from the path's centroid; 0 = plane wave.
        scale: Factor on the whole path.
        azimuth_rad: Even grid over [-π, π).
    """

    share: Float[NDArray, "d s a"]
    curvature_per_m: Float[NDArray, "d"]
    scale: Float[NDArray, "s"]
    azimuth_rad: Float[NDArray, "a"]

    @property
    def best_share(self) -> Float[NDArray, "a"]:
        """The most that any curvature and scale explains at each azimuth."""
        return self.share.max((0, 1))


def level_shares(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n s"],
    wavelength_m: float,
    curvature_per_m: Float[NDArray, "d"],
    scale: Float[NDArray, "s2"],
    azimuth_count: int = 1440,
    round_trip: bool = True,
) -> LevelShares:
    """``Σ_s |Σ_k h_ks exp(-j c k (r - |r u - p_k|))|² / (n Σ|h|²)`` for sources level with the path.

    The amplitude has few harmonics in azimuth (Jacobi-Anger: about k times the path's radius), so it is
    computed on as coarse a grid as holds them and interpolated exactly; equal steps of the scale are products
    with one constant factor instead of new exponentials.

    Args:
        position_m: Antenna path; heights are ignored.
        channel: Packets by subcarriers.
        wavelength_m: At the band centre.
        curvature_per_m: Distances tried, as one over metres.
        scale: Scales tried, equally spaced.
        azimuth_count: Of the result.
        round_trip: The channel is a forward x reverse product.
    """
    flat = (position_m - position_m.mean(0))[:, :2]
    k = wavenumber_rad_m(wavelength_m, round_trip)
    radius_m = float(np.linalg.norm(flat, axis=1).max())
    coarse = 2 * int(np.ceil(k * radius_m * scale[-1]) + _SPARE_HARMONICS)
    azimuth_rad = -np.pi + 2 * np.pi * np.arange(coarse) / coarse
    towards = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad)], 1) @ flat.T
    weights = principal_channels(channel)[0][:, :_CHANNELS].astype(np.complex64)
    total = len(channel) * float((np.abs(channel) ** 2).sum())
    step = float(scale[1] - scale[0]) if len(scale) > 1 else 0.0
    share = np.empty((len(curvature_per_m), len(scale), azimuth_count))
    for row, curvature in enumerate(curvature_per_m):
        phase = k * _advance_m(towards, (flat**2).sum(1), float(curvature))
        steering, factor = _turn(scale[0] * phase), _turn(step * phase)
        for column in range(len(scale)):
            amplitude = _interpolated(steering @ weights, azimuth_count)
            share[row, column] = (np.abs(amplitude) ** 2).sum(1) / total
            steering *= factor
    fine_rad = -np.pi + 2 * np.pi * np.arange(azimuth_count) / azimuth_count
    return LevelShares(share, np.asarray(curvature_per_m, float), np.asarray(scale, float), fine_rad)


def _advance_m(
    towards: Float[NDArray, "a n"], squared: Float[NDArray, "n"], curvature: float
) -> Float[NDArray, "a n"]:
    """How much nearer each position is to the source than the centroid."""
    if curvature <= 0:
        return towards
    r = 1 / curvature
    return r - np.sqrt(r * r - 2 * r * towards + squared)


def _turn(phase: Float[NDArray, "a n"]) -> Complex[NDArray, "a n"]:
    phase = phase.astype(np.float32)
    turned = np.empty(phase.shape, np.complex64)
    np.cos(phase, out=turned.real)
    np.sin(-phase, out=turned.imag)
    return turned


def _interpolated(amplitude: Complex[NDArray, "a r"], count: int) -> Complex[NDArray, "b r"]:
    """The same trigonometric polynomial on another even grid over [-π, π)."""
    spectrum = np.fft.fft(amplitude, axis=0)
    half = len(amplitude) // 2
    padded = np.zeros((count, amplitude.shape[1]), complex)
    padded[:half], padded[-half:] = spectrum[:half], spectrum[-half:]
    return np.fft.ifft(padded, axis=0) * (count / len(amplitude))
