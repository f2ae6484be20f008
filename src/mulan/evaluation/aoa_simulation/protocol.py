"""The whole simulation: run, judge, write."""

import json
from pathlib import Path
from typing import Any

from mulan.evaluation.aoa_simulation.experiments import (
    AoaSimulationConfig,
    Progress,
    efficiency,
    multipath,
    near_field,
    sigma_octiles,
)
from mulan.evaluation.aoa_simulation.picture import draw_simulation
from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import write_atomically

METRICS, PICTURE = "metrics.json", "aoa-simulation.png"


def evaluate_aoa_simulation(config: AoaSimulationConfig, out: Path, progress: Progress) -> dict[str, Any]:
    """Measure, then write ``metrics.json`` and the picture."""
    out.mkdir(parents=True, exist_ok=True)
    levels, trials = efficiency(config, progress)
    octiles = sigma_octiles(trials)
    echoes = multipath(config, progress)
    close = near_field(config, progress)
    ratios = [octile["empirical_over_claimed"] for octile in octiles]
    metrics = {
        "provenance": provenance(config.seed),
        "config": {**vars(config)},
        "efficiency": levels,
        "sigma_octiles": octiles,
        "multipath": echoes,
        "near_field": close,
        "goals": {
            "error_over_crb_at_most_1.10": max(level["error_over_crb"] for level in levels) <= 1.10,
            "sigma_within_15_percent_in_every_octile": all(abs(ratio - 1) <= 0.15 for ratio in ratios),
            "truth_among_hypotheses_at_least_0.95": echoes["truth_among_hypotheses"] >= 0.95,
            "at_least_3_nats_below_kappa_paper": echoes["nats_below_kappa_paper"] >= 3.0,
            "spherical_median_at_most_0.15_deg": close["spherical_median_error_deg"] <= 0.15,
        },
    }
    text = json.dumps(metrics, indent=1)
    write_atomically(out / METRICS, lambda temporary: temporary.write_text(text))
    draw_simulation(metrics, out / PICTURE)
    return metrics
