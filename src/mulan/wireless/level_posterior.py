"""Hypotheses for the azimuth of a source seen from a level path, with weights that reflections do not fool.

Real channels are one direct path, often not the strongest, among reflections that make the residual smooth
over centimetres; the path itself may be scaled (visual odometry), and its frame turned. The posterior over
azimuth, source distance and path scale is that of one path in noise of unknown level,
``(1 - share)^-looks``, where looks is the number of independent measurements the packets are worth.
docs/wireless.md tells how its constants were chosen.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy.typing import NDArray

from mulan.wireless.directions import unit_direction
from mulan.wireless.level_shares import LevelShares, level_shares

_CURVATURES_PER_M = np.array([0.0, 0.12, 0.25, 0.4])
_SCALE_STEP = 0.03
_WIDEST_SCALES = 0.18
_BEAM_RAD = np.deg2rad(6.0)
_BASIN_RAD = np.deg2rad(12.0)
_SMOOTHING_RAD = np.deg2rad(1.0)


@dataclass(frozen=True)
class LevelPosteriorConfig:
    """How azimuths of level paths are judged; the defaults were chosen on line-of-sight recordings only."""

    path_scale_sigma: float = 0.04
    """Standard deviation of the odometry's scale within an aperture; 0.05 for a visual-inertial one that has
    just been started. It also covers the cosine of the elevation."""
    scatter_sigma_rad: float = 0.017
    """Turn of the odometry's frame against the true one and scatter close about the source, one sigma."""
    bold_looks: float = 100.0
    """Independent measurements an aperture is worth where reflections correlate its packets, at most."""
    cautious_looks: float = 25.0
    """The same if another path may be stronger than the direct one."""
    least_outlier_mass: float = 0.02
    """Floor of the probability that no hypothesis is right."""
    hypotheses: int = 6
    """Directions kept, at most."""


@dataclass(frozen=True)
class LevelHypotheses:
    """Azimuths at the horizon, strongest peak first.

    Attributes:
        direction: Unit vectors, level.
        sigma_rad: Standard deviations of the azimuths.
        weight: Probabilities; with ``outlier_mass`` they sum to one.
        outlier_mass: Probability that none is right.
        share: Part of the power the first one explains.
    """

    direction: Float[NDArray, "k 3"]
    sigma_rad: Float[NDArray, "k"]
    weight: Float[NDArray, "k"]
    outlier_mass: float
    share: float


def level_hypotheses(
    position_m: Float[NDArray, "n 3"],
    channel: Complex[NDArray, "n s"],
    wavelength_m: float,
    range_m: float | None,
    independent_packets: float,
    config: LevelPosteriorConfig,
) -> LevelHypotheses:
    """The posterior's modes as a mixture.

    Args:
        position_m: Antenna path, level.
        channel: Round-trip channel, packets by subcarriers.
        wavelength_m: At the band centre.
        range_m: UWB range to the source, or None: then distances from 2.5 m to infinity are tried.
        independent_packets: Packets over the correlation length of what one direction leaves unexplained.
        config: Options.
    """
    reach = min(3 * config.path_scale_sigma, _WIDEST_SCALES)
    steps = int(np.ceil(reach / _SCALE_STEP))
    scale = 1 + _SCALE_STEP * np.arange(-steps, steps + 1)
    curvature = _CURVATURES_PER_M if range_m is None else np.array([1 / range_m])
    shares = level_shares(position_m, channel, wavelength_m, curvature, scale)
    # uncorrelated packets count in full; correlated ones as far as recordings have shown
    bold = min(float(len(channel)), max(config.bold_looks, independent_packets))
    cautious = bold * config.cautious_looks / config.bold_looks
    misfit = np.log1p(-np.clip(shares.share, 0.0, 0.999999))
    trusted = _posterior(misfit, shares.scale, bold, config.path_scale_sigma)
    rivalled = _rival_share(shares) ** 4
    doubted = _posterior(misfit, shares.scale, cautious, config.path_scale_sigma)
    blend = (1 - rivalled) * trusted + rivalled * doubted
    modes = _modes(_smoothed(trusted, _SMOOTHING_RAD), config.hypotheses)
    likelihood = _smoothed(trusted, config.scatter_sigma_rad)[modes]
    modes = modes[np.argsort(-likelihood, kind="stable")]
    return _mixture(shares, blend, modes, config)


def _posterior(
    misfit: Float[NDArray, "d s a"], scale: Float[NDArray, "s"], looks: float, scale_sigma: float
) -> Float[NDArray, "a"]:
    """Probability of each azimuth cell, distance and scale integrated out; the misfit is log(1 - share)."""
    log = -looks * misfit - 0.5 * ((scale - 1) / scale_sigma)[:, None] ** 2
    mass = np.exp(log - log.max()).sum((0, 1))
    return mass / mass.sum()


def _apart_rad(a: Float[NDArray, "*x"], b: Float[NDArray, "*y"] | float) -> Float[NDArray, "*z"]:
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi)


def _rival_share(shares: LevelShares) -> float:
    """Power of the strongest path outside the first one's beam, relative to the first."""
    best = shares.best_share
    outside = _apart_rad(shares.azimuth_rad, shares.azimuth_rad[best.argmax()]) > _BASIN_RAD
    return float(best[outside].max() / best.max())


def _smoothed(mass: Float[NDArray, "a"], sigma_rad: float) -> Float[NDArray, "a"]:
    """Circular convolution with a Gaussian."""
    harmonic = np.fft.rfftfreq(len(mass), 1 / len(mass))
    return np.maximum(np.fft.irfft(np.fft.rfft(mass) * np.exp(-0.5 * (harmonic * sigma_rad) ** 2)), 0.0)


def _modes(mass: Float[NDArray, "a"], count: int) -> Int[NDArray, "k"]:
    """Local maxima at least a beam apart, highest first."""
    peaks = np.flatnonzero((mass > np.roll(mass, 1)) & (mass >= np.roll(mass, -1)))
    cell_rad = 2 * np.pi / len(mass)
    kept: list[int] = []
    for peak in peaks[np.argsort(-mass[peaks], kind="stable")]:
        if (_apart_rad(np.array(kept, float) * cell_rad, float(peak) * cell_rad) > _BEAM_RAD).all():
            kept.append(int(peak))
        if len(kept) == count:
            break
    return np.array(kept, int)


def _mixture(
    shares: LevelShares,
    mass: Float[NDArray, "a"],
    modes: Int[NDArray, "k"],
    config: LevelPosteriorConfig,
) -> LevelHypotheses:
    """Mass and second moment of each mode's basin; what lies far from all modes is the outlier mass."""
    azimuth_rad = shares.azimuth_rad
    apart = _apart_rad(azimuth_rad[None], azimuth_rad[modes][:, None])
    owner = apart.argmin(0)
    inside = apart.min(0) <= _BASIN_RAD
    weight = np.array([mass[inside & (owner == k)].sum() for k in range(len(modes))])
    weight = np.maximum(weight, 1e-12)
    second = np.array([(mass * apart[k] ** 2)[inside & (owner == k)].sum() for k in range(len(modes))])
    sigma = np.sqrt(second / weight + config.scatter_sigma_rad**2)
    outlier_mass = max(float(mass[~inside].sum()), config.least_outlier_mass)
    weight = weight / weight.sum() * (1 - outlier_mass)
    direction = unit_direction(azimuth_rad[modes], np.zeros(len(modes)))
    return LevelHypotheses(direction, sigma, weight, outlier_mass, float(shares.best_share.max()))
