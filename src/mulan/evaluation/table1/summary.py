"""Figures of all seeds as the table shows them."""

import statistics
from collections.abc import Mapping
from typing import Any

MEANS = (
    "ssim",
    "lpips",
    "flip",
    "aligned_psnr_db",
    "camera_rms_m",
    "camera_median_m",
    "camera_max_m",
    "camera_rotation_median_deg",
    "nees_per_dof",
    "ause",
    "coverage_95",
    "train_seconds",
    "wall_seconds",
    "steps",
)
RIVALS = ("C", "paper_literal", "ours_weights", "ours")
"""Setups that try to win back what B loses."""

SetupFigures = Mapping[str, Mapping[str, Any]]
"""Figures of one seed by setup."""


def summarise(seeds: Mapping[int, SetupFigures], order: tuple[str, ...]) -> dict[str, Any]:
    """Mean and standard deviation over the seeds.

    Args:
        seeds: Figures by seed and setup; setups may be missing.
        order: Names of the setups.

    Returns:
        ``setups`` (of each: ``psnr_db`` mean and sample standard deviation, None of one seed; means of the
        rest, None where no seed has one), ``gap_recovered`` ((X - B)/(A - B)) and ``gap_recovered_vs_alone``
        ((X - alone)/(A - alone)) of the means over the seeds that have all three, None where there is no
        gap, and ``per_seed``.
    """
    setups = {}
    for name in order:
        found = [figures[name] for figures in seeds.values() if name in figures]
        if found:
            psnr = [float(one["psnr_db"]) for one in found]
            deviation = statistics.stdev(psnr) if len(psnr) > 1 else None
            setups[name] = {"psnr_db": {"mean": statistics.fmean(psnr), "std": deviation}}
            setups[name] |= {key: _mean([one.get(key) for one in found]) for key in MEANS}
            setups[name]["seeds"] = len(found)
    rivals = [name for name in RIVALS if name in setups]
    return {
        "setups": setups,
        "gap_recovered": {name: share_won_back(seeds, name, "B") for name in rivals},
        "gap_recovered_vs_alone": {name: share_won_back(seeds, name, "alone") for name in rivals},
        "per_seed": {
            str(seed): {
                name: {key: figures[name].get(key) for key in ("psnr_db", *MEANS)}
                for name in order
                if name in figures
            }
            for seed, figures in seeds.items()
        },
    }


def share_won_back(seeds: Mapping[int, SetupFigures], name: str, floor: str) -> float | None:
    """(X - floor)/(A - floor) of the mean PSNRs over the seeds that have all three."""
    complete = [figures for figures in seeds.values() if {"A", name, floor} <= set(figures)]
    if not complete:
        return None
    oracle, rival, lowest = (
        statistics.fmean(figures[key]["psnr_db"] for figures in complete) for key in ("A", name, floor)
    )
    return (rival - lowest) / (oracle - lowest) if oracle > lowest else None


def _mean(values: list[float | None]) -> float | None:
    present = [value for value in values if value is not None]
    return statistics.fmean(present) if present else None
