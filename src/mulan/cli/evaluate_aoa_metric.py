"""``mulan evaluate aoa-metric``: the paper's two figures, and ours of the same links."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from mulan.cli.progress import console, progress_stages
from mulan.evaluation.aoa_metric.protocol import METRICS, PICTURE, evaluate_aoa_metric
from mulan.evaluation.aoa_metric.sweep import LAWS, AoaMetricConfig


@dataclass(frozen=True)
class Options:
    """Error and its variance over the paper's AoA metric, for several apertures, beside our own sigma."""

    out: Path
    """Folder to write; metrics.json, aoa-metric.png and kappa-calibration-*.json lie in it."""
    quick: bool = False
    """Few links: shows that the command works, measures nothing."""
    sweep: Annotated[AoaMetricConfig, tyro.conf.arg(name="")] = field(default_factory=AoaMetricConfig)
    """Size of the sweep."""


def _law(laws: dict[str, Any]) -> str:
    law = laws["kappa_paper"]
    return f"b = {law['exponent']:.2f}, r² = {law['r_squared']:.2f}" if law else "too few windows"


def main(arguments: Sequence[str]) -> int:
    """Sweep, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate aoa-metric")
    config = options.sweep
    if options.quick:
        config = replace(config, extents_m=(0.2,), trials=20, fewest_in_window=3)
    with progress_stages() as stage:
        metrics = evaluate_aoa_metric(config, options.out, stage("sweeping phase noise"))
    for aperture in metrics["apertures"]:
        rank = aperture["spearman_with_abs_error"]
        square, absolute = (_law(aperture[law]) for law in LAWS)
        console.print(
            f"{aperture['extent_m']:g} m: kappa_paper {square} for the mean square error, "
            f"{absolute} for the variance of the absolute error, "
            f"Spearman {rank['kappa_paper']:.2f} (ours {rank['ours']:.2f})"
        )
    console.print(f"Metrics: [bold]{options.out / METRICS}[/], picture: [bold]{options.out / PICTURE}[/]")
    return 0
