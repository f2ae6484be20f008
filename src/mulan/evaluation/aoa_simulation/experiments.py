"""The four questions put to the estimator, each with a link simulator and a figure."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.aoa_simulation.bounds import direction_bound
from mulan.evaluation.aoa_simulation.links import WAVELENGTH_M, SimulatedLink, loop, simulate_link
from mulan.evaluation.aoa_simulation.trials import Trial, angle_rad, mixture_density, run_trial
from mulan.wireless.kappa_calibration import fit_kappa_calibration
from mulan.wireless.multipath import resolve_paths
from mulan.wireless.peak import steering_model

Progress = Callable[[int, int, str], None]

INLIER_DEG = 3.0  # the main lobe of the apertures used here
FOUND_DEG = 5.0


@dataclass(frozen=True)
class AoaSimulationConfig:
    """Size of the simulation."""

    noise_rad: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.25, 1.5)
    """Round-trip phase noise levels."""
    trials: int = 300
    """Links a noise level."""
    multipath_trials: int = 300
    """Links with echoes that are scored; as many others fit the paper's metric."""
    resolved_trials: int = 50
    """Of the scored links with echoes, so many are also given to the joint estimate of all paths."""
    near_field_trials: int = 200
    """Links at 3–10 m, seen by spherical and plane waves."""
    packets: int = 300
    """Packets a link."""
    extent_m: float = 0.5
    """Diameter of the antenna path of the first three experiments."""
    seed: int = 0
    """Source of all randomness."""


def efficiency(config: AoaSimulationConfig, progress: Progress) -> tuple[list[dict[str, Any]], list[Trial]]:
    """Error over the Cramér–Rao bound at each noise level, and all trials."""
    rng = np.random.default_rng([config.seed, 1])
    rows, everything = [], []
    for done, noise in enumerate(config.noise_rad):
        progress(done, len(config.noise_rad), f"phase noise {noise:g} rad")
        trials, squared_ratio = [], []
        for _ in range(config.trials):
            path = loop(config.packets, config.extent_m, rng.uniform(0, 2 * np.pi))
            link = simulate_link(path, rng.uniform(3, 10), rng, noise)
            trial = run_trial(link, link.range_m)
            bound = direction_bound(path, link.direction, link.range_m, noise)
            trials.append(trial)
            squared_ratio.append(trial.top_error_rad @ np.linalg.solve(bound, trial.top_error_rad) / 2)
        inlier = np.array([np.degrees(t.error_rad[0]) < INLIER_DEG for t in trials])
        error_deg = np.degrees([t.error_rad[0] for t in trials])[inlier]
        rows.append(
            {
                "phase_noise_rad": noise,
                "links": len(trials),
                "error_over_crb": float(np.sqrt(np.mean(np.array(squared_ratio)[inlier]))),
                "rms_error_deg": float(np.sqrt(np.mean(error_deg**2))),
                "outlier_share": float(1 - inlier.mean()),
                "mean_claimed_outlier_mass": float(np.mean([t.outlier_mass for t in trials])),
            }
        )
        everything += trials
    return rows, everything


def sigma_octiles(trials: list[Trial]) -> list[dict[str, float]]:
    """Empirical over claimed sigma in eight classes of claimed sigma, inliers only; nothing is fitted.

    Both are pooled over the class in units of the claim: RMS of the whitened error, one is perfect.
    """
    inlier = [t for t in trials if np.degrees(t.error_rad[0]) < INLIER_DEG]
    sigma = np.array([t.sigma_rad for t in inlier])
    whitened = np.array(
        [t.top_error_rad @ np.linalg.solve(t.covariance, t.top_error_rad) / 2 for t in inlier]
    )
    return [
        {
            "claimed_sigma_deg": float(np.degrees(np.median(sigma[part]))),
            "empirical_over_claimed": float(np.sqrt(whitened[part].mean())),
            "links": len(part),
        }
        for part in np.array_split(np.argsort(sigma, kind="stable"), 8)
        if len(part)
    ]


def multipath(config: AoaSimulationConfig, progress: Progress) -> dict[str, Any]:
    """Links with one to three echoes: is the truth kept, with what density, beside the paper."""

    def links(stream: int, count: int, first: int) -> tuple[list[Trial], list[SimulatedLink]]:
        rng = np.random.default_rng([config.seed, stream])
        trials, simulated = [], []
        for number in range(count):
            if number % 20 == 0:
                progress(first + number, 2 * config.multipath_trials, "links with echoes")
            path = loop(config.packets, config.extent_m, rng.uniform(0, 2 * np.pi))
            link = simulate_link(
                path, rng.uniform(3, 10), rng, 0.3, echoes=int(rng.integers(1, 4)), snr_db=25.0
            )
            trials.append(run_trial(link, link.range_m))
            simulated.append(link)
        return trials, simulated

    (fitted, _), (held_out, simulated) = (
        links(stream, config.multipath_trials, first)
        for stream, first in ((2, 0), (3, config.multipath_trials))
    )

    def of(trials: list[Trial], name: str) -> Float[NDArray, "n"]:
        return np.array([getattr(t, name) for t in trials])

    kappa, peak = of(fitted, "kappa_paper"), of(fitted, "peak_error_rad")
    robust = fit_kappa_calibration(kappa, peak)
    bare = fit_kappa_calibration(kappa, peak, outlier_mass=1e-6)
    kappa, peak = of(held_out, "kappa_paper"), of(held_out, "peak_error_rad")
    ours = float(of(held_out, "negative_log_density").mean())
    paper = float(robust.negative_log_density(kappa, peak).mean())
    top_deg = np.degrees([t.error_rad[0] for t in held_out])
    return {
        "links": len(held_out),
        "found_within_deg": FOUND_DEG,
        "truth_among_hypotheses": float(
            np.mean([np.degrees(t.error_rad.min()) < FOUND_DEG for t in held_out])
        ),
        "truth_is_first_hypothesis": float(np.mean(top_deg < FOUND_DEG)),
        "median_core_error_deg": float(np.median(top_deg[top_deg < FOUND_DEG])),
        "profile_peak_within": float(np.mean(np.degrees(peak) < FOUND_DEG)),
        "mean_hypotheses": float(np.mean([len(t.error_rad) for t in held_out])),
        "nll": ours,
        "nll_kappa_paper": paper,
        "nll_kappa_paper_no_outlier_mass": float(bare.negative_log_density(kappa, peak).mean()),
        "nats_below_kappa_paper": paper - ours,
        "kappa_calibration": vars(robust),
        "resolve_paths": _resolved(simulated[: config.resolved_trials]),
    }


def _resolved(links: Sequence[SimulatedLink]) -> dict[str, Any]:
    """The joint estimate of all paths on some links, and what it costs."""
    errors, density, begin = [], [], time.process_time()
    for link in links:
        paths = resolve_paths(steering_model(link.position_m, WAVELENGTH_M, link.range_m), link.channel)
        errors.append(np.degrees(angle_rad(paths.direction, link.direction)))
        density.append(
            mixture_density(
                paths.direction, paths.covariance, paths.weight, paths.outlier_mass, link.direction
            )
        )
    first = np.array([error[0] for error in errors])
    return {
        "links": len(links),
        "truth_among_paths": float(np.mean([error.min() < FOUND_DEG for error in errors])),
        "truth_is_strongest_path": float(np.mean(first < FOUND_DEG)),
        "median_strongest_error_deg": float(np.median(first)),
        "nll": float(-np.log(density).mean()),
        "processor_s_a_link": (time.process_time() - begin) / max(len(links), 1),
    }


def near_field(config: AoaSimulationConfig, progress: Progress) -> dict[str, Any]:
    """Large paths close by: spherical steering with the range (5 cm sigma) beside plane waves."""
    rng = np.random.default_rng([config.seed, 4])
    errors: dict[str, list[float]] = {"spherical": [], "plane_wave": []}
    for number in range(config.near_field_trials):
        if number % 20 == 0:
            progress(number, config.near_field_trials, "links close by")
        path = loop(config.packets, rng.uniform(1.0, 1.5), rng.uniform(0, 2 * np.pi))
        link = simulate_link(path, rng.uniform(3, 10), rng, 0.3)
        told = link.range_m + 0.05 * rng.normal()
        for name, range_m in (("spherical", told), ("plane_wave", None)):
            errors[name].append(float(np.degrees(run_trial(link, range_m).error_rad[0])))
    return {
        "links": config.near_field_trials,
        **{f"{name}_median_error_deg": float(np.median(values)) for name, values in errors.items()},
        **{f"{name}_p90_error_deg": float(np.percentile(values, 90)) for name, values in errors.items()},
    }
