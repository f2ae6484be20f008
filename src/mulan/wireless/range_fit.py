"""Maximum a posteriori fit of a ``RangeModel`` to ranges with truth, by expectation-maximisation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy.special import log_ndtr

from mulan.errors import InputError
from mulan.wireless.range_correlation import correlation_time_s
from mulan.wireless.range_model import LinkError, RangeModel
from mulan.wireless.recordings.uwb_samples import RangeSamples


@dataclass(frozen=True)
class RangeFitConfig:
    """How error laws are fitted."""

    iterations: int = 150
    """Expectation-maximisation rounds."""
    prior_count: float = 5.0
    """Independent measurements the pooled law counts for beside a link's own."""
    smallest_sigma_m: float = 0.005
    """Floor of the core's standard deviation."""
    smallest_gross_mass: float = 1e-4
    """Nothing is ever impossible: floor of the pooled gross mass."""
    slope_sigma_per_m: float = 0.03
    """Prior of the bias's growth with distance, one sigma."""
    device_sigma_m: float = 0.1
    """Prior of a device's deviation from the mean bias, one sigma."""
    span_m: float = 10.0
    """A gross error lies within ± this, or one and a half times the largest seen."""


def _devices(
    links: tuple[tuple[str, str], ...], bias: NDArray, sigma: NDArray, ridge: float
) -> tuple[float, dict[str, float], NDArray]:
    """Mean bias, each device's deviation (ridge least squares) and what they predict for the links."""
    names = sorted({name for link in links for name in link})
    design = np.array([[float(name in link) for name in names] for link in links])
    mean = float(np.average(bias, weights=1 / sigma**2))
    normal = design.T / sigma**2 @ design + np.eye(len(names)) / ridge**2
    device = np.linalg.solve(normal, design.T / sigma**2 @ (bias - mean))
    return mean, dict(zip(names, device.tolist(), strict=True)), mean + design @ device


def _posterior_detour(u: NDArray, sigma: NDArray, tau: NDArray) -> tuple[NDArray, NDArray]:
    """Mean and second moment of the detour, a Gaussian cut at zero."""
    centre = u - sigma**2 / tau
    a = centre / sigma
    # hazard of the normal, stable far below zero
    hazard = np.exp(-0.5 * a**2 - 0.5 * np.log(2 * np.pi) - log_ndtr(a))
    mean = np.maximum(centre + sigma * hazard, 0.0)
    return mean, np.maximum(sigma**2 + centre * mean, mean**2)


def fit_range_model(samples: RangeSamples, config: RangeFitConfig | None = None) -> RangeModel:
    """Bias, scatter, detours and gross errors of every link, each drawn towards the pooled law.

    Errors that last seconds are counted once: each measurement weighs the share of an independent one, so a
    minute of 100 Hz does not overrule the prior.

    Raises:
        InputError: There are fewer than ten ranges, or a value is not finite.
    """
    config = config or RangeFitConfig()
    if len(samples.range_m) < 10:
        raise InputError(samples.name, "ranges", "are fewer than ten", "record for longer")
    if not np.isfinite(samples.error_m).all():
        raise InputError(samples.name, "ranges", "hold a value that is not finite", "remove it")
    link, count, error = samples.link, len(samples.links), samples.error_m
    correlation_s, weight = correlation_time_s(link, samples.time_s, error)
    span = max(config.span_m, 1.5 * float(np.abs(error).max()))
    reference = float(np.median(samples.true_range_m))
    lever = samples.true_range_m - reference

    def total(values: Float[NDArray, "n"]) -> Float[NDArray, "l"]:
        return np.bincount(link, weight * values, minlength=count)

    slope = 0.0
    seen = np.bincount(link, minlength=count) > 0
    bias = _by_link(link, error, count, float(np.median(error)))
    scatter = np.abs(error - bias[link])
    sigma = np.maximum(1.4826 * _by_link(link, scatter, count, float(np.median(scatter))), 0.01)
    tau, late, gross = np.full(count, 0.3), np.full(count, 0.1), np.full(count, 0.01)
    k = config.prior_count
    device: dict[str, float] = {}
    pooled = LinkError(0.0, 0.1, 0.1, 0.3, 0.01)
    n = total(np.ones(len(error)))
    for _ in range(config.iterations):
        laws = tuple(LinkError(*map(float, row)) for row in zip(bias, sigma, late, tau, gross, strict=True))
        model = RangeModel(samples.links, (*laws, pooled), device, slope, reference, span, correlation_s)
        at_reference = error - slope * lever
        parts = model.log_components(link, at_reference)
        r_core, r_late, r_gross = np.exp(parts - np.logaddexp.reduce(parts, axis=0))
        detour, square = _posterior_detour(at_reference - bias[link], sigma[link], tau[link])
        r_in, precision = r_core + r_late, 1 / sigma[link] ** 2
        inlier = total(r_in)
        delayed = error * r_in - r_late * detour  # of mean bias + slope·lever, over r_in
        top = np.sum(weight * precision * lever * (delayed - r_in * bias[link]))
        slope = top / (np.sum(weight * precision * r_in * lever**2) + config.slope_sigma_per_m**-2)
        mean, device, predicted = _devices(
            samples.links, bias, np.sqrt(sigma**2 / np.maximum(n, 0.1) + 0.05**2), config.device_sigma_m
        )
        bias = (total(delayed - r_in * slope * lever) + k * predicted) / (inlier + k)
        u = error - slope * lever - bias[link]
        spread = total(r_core * u**2 + r_late * (u**2 - 2 * u * detour + square))
        variance = np.exp(np.average(np.log((spread + 1e-6) / (inlier + 1e-6))[seen], weights=n[seen]))
        sigma = np.sqrt((spread + k * variance) / (inlier + k))
        sigma = np.maximum(sigma, config.smallest_sigma_m)
        late_n, gross_n, whole = total(r_late), total(r_gross), n.sum()
        late_0, gross_0 = late_n.sum() / whole, max(gross_n.sum() / whole, config.smallest_gross_mass)
        tau_0 = (total(r_late * detour).sum() + 0.3) / (late_n.sum() + 1)
        late, gross = (late_n + k * late_0) / (n + k), (gross_n + k * gross_0) / (n + k)
        tau = np.maximum((total(r_late * detour) + k * tau_0 * late_0) / (late_n + k * late_0), 0.01)
        # an unseen link: the scatter of biases about what devices predict joins the core
        unseen = np.sqrt(variance + np.mean((bias - predicted)[seen] ** 2))
        pooled = LinkError(mean, float(unseen), float(late_0), float(max(tau_0, 0.01)), float(gross_0))
    laws = tuple(LinkError(*map(float, row)) for row in zip(bias, sigma, late, tau, gross, strict=True))
    return RangeModel(samples.links, (*laws, pooled), device, float(slope), reference, span, correlation_s)


def _by_link(link: Int[NDArray, "n"], values: Float[NDArray, "n"], count: int, otherwise: float) -> NDArray:
    medians = np.full(count, otherwise)
    for number in np.unique(link):
        medians[number] = np.median(values[link == number])
    return medians
