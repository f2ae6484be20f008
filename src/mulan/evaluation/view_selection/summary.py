"""Figures of all seeds as metrics.json has them."""

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import t as student_t

from mulan.evaluation.view_selection.policies import BLIND, CERTAIN, FARTHEST, RANDOM

REFERENCES = (RANDOM, FARTHEST, CERTAIN, BLIND)
"""Policies the others are compared with, seed by seed."""

SeedFigures = Mapping[str, Mapping[str, Any]]
"""Figures of one seed by policy."""


def summarise(
    seeds: Mapping[int, SeedFigures], policies: Sequence[str], views: Sequence[int]
) -> dict[str, Any]:
    """Mean, spread and paired differences over the seeds.

    Returns:
        ``policies``: of each, by number of views as text, ``psnr_db`` (mean, sample standard deviation, None
        of one seed), ``minus`` (by reference: mean of the paired differences with ``low`` and ``high`` of
        its 95 % interval by Student's t, None below two seeds), where judged ``ause``, ``spearman`` and
        ``ensemble_psnr_db``; besides, ``plan_ms`` a candidate and ``seeds``.
    """
    result = {}
    for name in policies:
        found = {seed: figures[name] for seed, figures in seeds.items() if name in figures}
        if not found:
            continue
        at = {}
        for count in map(str, views):
            observed = [one["observations"][count] for one in found.values()]
            at[count] = {
                "psnr_db": spread([one["psnr_db"] for one in observed]),
                "minus": {
                    reference: paired_difference(seeds, name, reference, count)
                    for reference in REFERENCES
                    if reference != name and any(reference in figures for figures in seeds.values())
                },
                **_variance(observed),
            }
        plan_ms = [one["plan_ms"] for one in found.values() if one["plan_ms"] is not None]
        result[name] = {
            "views": at,
            "plan_ms": statistics.fmean(plan_ms) if plan_ms else None,
            "seeds": len(found),
        }
    return {"policies": result}


def spread(values: Sequence[float]) -> dict[str, float | None]:
    """Mean and sample standard deviation."""
    deviation = statistics.stdev(values) if len(values) > 1 else None
    return {"mean": statistics.fmean(values), "std": deviation}


def paired_difference(
    seeds: Mapping[int, SeedFigures], name: str, reference: str, count: str
) -> dict[str, float | int | None] | None:
    """Mean of ``name`` less ``reference`` over the seeds that have both, with its 95 % interval."""
    differences = [
        figures[name]["observations"][count]["psnr_db"] - figures[reference]["observations"][count]["psnr_db"]
        for figures in seeds.values()
        if name in figures and reference in figures
    ]
    if not differences:
        return None
    mean, n = statistics.fmean(differences), len(differences)
    if n < 2:
        return {"mean": mean, "low": None, "high": None, "seeds": n}
    half = float(student_t.ppf(0.975, n - 1)) * statistics.stdev(differences) / math.sqrt(n)
    return {"mean": mean, "low": mean - half, "high": mean + half, "seeds": n}


def _variance(observed: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    judged = [one for one in observed if "ause" in one]
    if not judged:
        return {}
    means: dict[str, Any] = {
        figure: {name: statistics.fmean(one[figure][name] for one in judged) for name in judged[0][figure]}
        for figure in ("ause", "spearman")
    }
    means["ensemble_psnr_db"] = spread([one["ensemble_psnr_db"] for one in judged])
    return means
