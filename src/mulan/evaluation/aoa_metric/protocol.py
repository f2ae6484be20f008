"""Sweep every aperture, fit, write."""

import json
from pathlib import Path
from typing import Any

from mulan.evaluation.aoa_metric.picture import draw_metric
from mulan.evaluation.aoa_metric.sweep import LAWS, AoaMetricConfig, Progress, summary, sweep_noise
from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import write_atomically
from mulan.wireless.kappa_calibration import fit_kappa_calibration

METRICS, PICTURE = "metrics.json", "aoa-metric.png"


def evaluate_aoa_metric(config: AoaMetricConfig, out: Path, progress: Progress) -> dict[str, Any]:
    """Measure, then write ``metrics.json``, the picture and each aperture's calibration of the metric."""
    out.mkdir(parents=True, exist_ok=True)
    sweeps = [sweep_noise(extent_m, config, progress) for extent_m in config.extents_m]
    apertures = [summary(sweep, config) for sweep in sweeps]
    for sweep in sweeps:
        calibration = fit_kappa_calibration(sweep.kappa_paper, sweep.peak_error_rad)
        calibration.save(out / f"kappa-calibration-{sweep.extent_m:g}m.json")
    passing = {
        name: [
            aperture["extent_m"]
            for aperture in apertures
            if (law := aperture[name]["kappa_paper"]) and law["exponent"] > 1 and law["r_squared"] >= 0.75
        ]
        for name in LAWS
    }
    metrics = {
        "provenance": provenance(config.seed),
        "config": {**vars(config)},
        "apertures": apertures,
        "goals": {"exponent_above_1_and_r_squared_at_least_0.75_at_extents_m": passing},
        "variance_is": {name: variance.value for name, variance in LAWS.items()},
    }
    text = json.dumps(metrics, indent=1)
    write_atomically(out / METRICS, lambda temporary: temporary.write_text(text))
    draw_metric(sweeps, metrics, config, out / PICTURE)
    return metrics
