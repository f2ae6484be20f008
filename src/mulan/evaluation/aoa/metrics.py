"""Figures of merit over scored links: accuracy, ranking, calibration."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.stats import rankdata

from mulan.evaluation.aoa.scored_link import FailedLink, ScoredLink

POOLED = "pooled"
_FAR_DEG, _NEAR_DEG = 20.0, 10.0

Figures = dict[str, Any]


def rank_correlation(a: Float[NDArray, "n"], b: Float[NDArray, "n"]) -> float | None:
    """Spearman's, or None where it is not defined."""
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])


def _column(links: Sequence[ScoredLink], name: str) -> Float[NDArray, "n"]:
    return np.array([getattr(link, name) for link in links], float)


def _accuracy(error_deg: Float[NDArray, "n"]) -> Figures:
    off = np.abs(error_deg)
    return {
        "mean_abs_error_deg": float(off.mean()),
        "median_abs_error_deg": float(np.median(off)),
        "over_20deg": float((off > _FAR_DEG).mean()),
    }


def our_figures(links: Sequence[ScoredLink], failed: Sequence[FailedLink]) -> Figures:
    """All figures of our estimator; failed links are counted and named, they have no error."""
    names = {"failed": len(failed), "failed_links": [f"{f.run} {f.link}".strip() for f in failed]}
    if not links:
        return {"links": 0, **names}
    error, level = np.abs(_column(links, "error_deg")), _column(links, "level")
    return {
        "links": len(links),
        **_accuracy(error),
        "top3_within_10deg": float((_column(links, "best_of_three_deg") <= _NEAR_DEG).mean()),
        "top1_within_10deg": float((error <= _NEAR_DEG).mean()),
        "spearman": rank_correlation(_column(links, "sigma_deg"), error),
        "coverage_68": float((level <= 0.68).mean()),
        "coverage_95": float((level <= 0.95).mean()),
        "mean_signed_error_deg": float(_column(links, "error_deg").mean()),
        "spearman_mean_abs": rank_correlation(_column(links, "mean_abs_deg"), error),
        "spearman_first_sigma": rank_correlation(_column(links, "first_sigma_deg"), error),
        "spearman_kappa_paper": rank_correlation(_column(links, "kappa_paper"), error),
        "median_sigma_deg": float(np.median(_column(links, "sigma_deg"))),
        "mean_outlier_mass": float(_column(links, "outlier_mass").mean()),
        "mean_nll": float(_column(links, "nll").mean()),
        "start_truth": _accuracy(_column(links, "error_start_deg")),
        "own_axes_truth": _accuracy(_column(links, "error_own_axes_deg")),
        "links_with_faults": int(np.count_nonzero(_column(links, "faults"))),
        "median_packets": float(np.median(_column(links, "packets"))),
        "median_milliseconds": float(np.median(_column(links, "milliseconds"))),
        **names,
    }


def reported_figures(links: Sequence[ScoredLink], _: Sequence[FailedLink] = ()) -> Figures:
    """The same of what others reported, on the links we measured; None where it is not defined for them."""
    theirs = [link for link in links if link.reported_error_deg is not None]
    if not theirs:
        return {"links": 0}
    error = np.abs(_column(theirs, "reported_error_deg"))
    return {
        "links": len(theirs),
        **_accuracy(error),
        "top3_within_10deg": None,
        "top1_within_10deg": float((error <= _NEAR_DEG).mean()),
        "spearman": rank_correlation(_column(theirs, "reported_variance"), error),
        "coverage_68": None,
        "coverage_95": None,
        "mean_signed_error_deg": float(_column(theirs, "reported_error_deg").mean()),
        "origin_truth": _accuracy(_column(theirs, "reported_error_origin_deg")),
        "median_packets": float(np.median(_column(theirs, "reported_packets"))),
    }


def figures_by_source(
    figures: Callable[[Sequence[ScoredLink], Sequence[FailedLink]], Figures],
    links: Sequence[ScoredLink],
    failed: Sequence[FailedLink],
) -> dict[str, Figures]:
    """One entry a displacement source that occurs."""
    sources = dict.fromkeys([*(link.source for link in links), *(f.source for f in failed if f.source)])
    return {
        source: figures(
            [link for link in links if link.source == source],
            [f for f in failed if f.source in (source, "")],
        )
        for source in sources
    }


def aoa_metrics(links: Sequence[ScoredLink], failed: Sequence[FailedLink]) -> dict[str, Any]:
    """``sets`` (by set and displacement source), ``all`` (by source, and pooled) and ``authors`` (alike)."""

    def part(figures: Callable[[Sequence[ScoredLink], Sequence[FailedLink]], Figures]) -> dict[str, Any]:
        names = dict.fromkeys([*(link.set for link in links), *(f.set for f in failed)])
        return {
            "sets": {
                name: figures_by_source(
                    figures,
                    [link for link in links if link.set == name],
                    [f for f in failed if f.set == name],
                )
                for name in names
            },
            "all": {**figures_by_source(figures, links, failed), POOLED: figures(links, failed)},
        }

    return {**part(our_figures), "authors": part(reported_figures)}
