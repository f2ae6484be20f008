"""Noise sweep of the paper's section "Wireless Variance": metric, error and our sigma on the same links."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from scipy.stats import spearmanr

from mulan.evaluation.aoa_simulation.links import loop, simulate_link
from mulan.evaluation.aoa_simulation.trials import run_trial

Progress = Callable[[int, int, str], None]


class ErrorVariance(Enum):
    """What "variance of the error" means; the paper does not say.

    The error is a displacement on the sphere that is zero on average, so its variance is the mean square of
    the angle. That of the angle itself is about its mean; it falls again once all directions are random.
    """

    MEAN_SQUARE = "mean_square"
    OF_ABSOLUTE = "of_absolute"


@dataclass(frozen=True)
class AoaMetricConfig:
    """Size of the sweep."""

    extents_m: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.5)
    """Diameters of the antenna path."""
    trials: int = 640
    """Links a diameter; the phase noise on the measured channel sweeps ``noise_rad`` evenly."""
    noise_rad: tuple[float, float] = (0.01, 3.0)
    """Least and largest phase noise."""
    packets: int = 200
    """Packets a link."""
    window_share: float = 0.1
    """Width of the sliding window over the metric, as a share of its range."""
    fewest_in_window: int = 10
    """Windows of fewer links have no variance."""
    seed: int = 0
    """Source of all randomness."""


@dataclass(frozen=True)
class PowerLaw:
    """``y = factor · x^exponent`` by least squares on y, as the paper fits it.

    Attributes:
        factor, exponent: Of the law; x is the metric over its mean.
        r_squared: Share of y's variance it explains.
    """

    factor: float
    exponent: float
    r_squared: float


@dataclass(frozen=True)
class Sweep:
    """All links of one aperture.

    Attributes:
        extent_m: Diameter of the antenna path.
        noise_rad: Phase noise of each link.
        kappa_paper: The paper's metric.
        peak_error_rad: Error of the profile's highest cell, which the paper takes.
        error_rad: Error of our best hypothesis.
        sigma_rad: Our standard deviation of one axis, the outlier mass not in it.
        spread_rad: Root mean square error we claim: sigma of both axes, outliers anywhere on the sphere.
    """

    extent_m: float
    noise_rad: Float[NDArray, "n"]
    kappa_paper: Float[NDArray, "n"]
    peak_error_rad: Float[NDArray, "n"]
    error_rad: Float[NDArray, "n"]
    sigma_rad: Float[NDArray, "n"]
    spread_rad: Float[NDArray, "n"]


def sweep_noise(extent_m: float, config: AoaMetricConfig, progress: Progress) -> Sweep:
    """Simulate and estimate."""
    rng = np.random.default_rng([config.seed, round(extent_m * 1e4)])
    noise = np.linspace(*config.noise_rad, config.trials)
    trials = []
    for number, phase_noise_rad in enumerate(noise):
        if number % 20 == 0:
            progress(number, config.trials, f"aperture {extent_m:g} m")
        path = loop(config.packets, extent_m, rng.uniform(0, 2 * np.pi))
        link = simulate_link(path, rng.uniform(3, 10), rng, float(phase_noise_rad))
        trials.append(run_trial(link, link.range_m))
    mass = np.array([t.outlier_mass for t in trials])
    sigma = np.array([t.sigma_rad for t in trials])
    # a direction anywhere on the sphere errs by (π² - 4)/2 in mean square
    spread = np.sqrt((1 - mass) * 2 * sigma**2 + mass * (np.pi**2 - 4) / 2)
    return Sweep(
        extent_m,
        noise,
        np.array([t.kappa_paper for t in trials]),
        np.array([t.peak_error_rad for t in trials]),
        np.array([t.error_rad[0] for t in trials]),
        sigma,
        np.minimum(spread, np.pi),
    )


def variance_in_windows(
    metric: Float[NDArray, "n"],
    error_rad: Float[NDArray, "n"],
    config: AoaMetricConfig,
    variance: ErrorVariance = ErrorVariance.MEAN_SQUARE,
) -> tuple[Float[NDArray, "w"], Float[NDArray, "w"]]:
    """Window centres and the variance of the error [rad²] in a window that slides by a fifth."""
    low, high = metric.min(), metric.max()
    width = config.window_share * (high - low)
    centres, variances = [], []
    for begin in np.arange(low, high - width + 1e-12 * high, width / 5):
        inside = (metric >= begin) & (metric <= begin + width)
        if inside.sum() >= config.fewest_in_window:
            centres.append(metric[inside].mean())
            error = error_rad[inside]
            variances.append((error**2).mean() if variance is ErrorVariance.MEAN_SQUARE else error.var())
    return np.array(centres), np.array(variances)


def fit_power_law(x: Float[NDArray, "w"], y: Float[NDArray, "w"]) -> PowerLaw | None:
    """The law of a scatter, or None for fewer than four points."""
    if len(x) < 4:
        return None
    unit = x / x.mean()
    best, _ = curve_fit(
        lambda t, a, b: a * t**b, unit, y, p0=(float(y.mean()) + 1e-12, 1.5), bounds=([0, -10], [np.inf, 30])
    )
    residual = y - best[0] * unit ** best[1]
    return PowerLaw(float(best[0]), float(best[1]), float(1 - residual.var() / max(y.var(), 1e-300)))


LAWS = {
    "power_law": ErrorVariance.MEAN_SQUARE,
    "power_law_of_absolute_error": ErrorVariance.OF_ABSOLUTE,
}
"""Names of the fits in metrics.json."""


def summary(sweep: Sweep, config: AoaMetricConfig) -> dict[str, Any]:
    """Figures of one aperture: power laws and rank correlations of both metrics."""
    laws = {
        variance: {
            "kappa_paper": fit_power_law(
                *variance_in_windows(sweep.kappa_paper, sweep.peak_error_rad, config, variance)
            ),
            "ours": fit_power_law(*variance_in_windows(sweep.spread_rad, sweep.error_rad, config, variance)),
        }
        for variance in ErrorVariance
    }
    return {
        "extent_m": sweep.extent_m,
        "links": len(sweep.noise_rad),
        **{
            name: {metric: law and vars(law) for metric, law in laws[variance].items()}
            for name, variance in LAWS.items()
        },
        "spearman_with_abs_error": {
            "kappa_paper": float(np.asarray(spearmanr(sweep.kappa_paper, sweep.peak_error_rad))[0]),
            "ours": float(np.asarray(spearmanr(sweep.spread_rad, sweep.error_rad))[0]),
        },
    }
