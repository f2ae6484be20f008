"""``mulan evaluate aoa-metric``: the paper's two figures, and ours of the same links."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from mulan.cli.progress import console, progress_stages
from mulan.evaluation.aoa_metric.protocol import METRICS, PICTURE, evaluate_aoa_metric
from mulan.evaluation.aoa_metric.sweep import AoaMetricConfig


@dataclass(frozen=True)
class Options:
    """Error and its variance over the paper's AoA metric, for several apertures, beside our own sigma."""

    out: Path
    """Folder to write; metrics.json, aoa-metric.png and kappa-calibration-*.json lie in it."""
    quick: bool = False
    """Few links: shows that the command works, measures nothing."""
    sweep: Annotated[AoaMetricConfig, tyro.conf.arg(name="")] = field(default_factory=AoaMetricConfig)
    """Size of the sweep."""


def main(arguments: Sequence[str]) -> int:
    """Sweep, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate aoa-metric")
    config = options.sweep
    if options.quick:
        config = replace(config, extents_m=(0.2,), trials=20, fewest_in_window=3)
    with progress_stages() as stage:
        metrics = evaluate_aoa_metric(config, options.out, stage("sweeping phase noise"))
    for aperture in metrics["apertures"]:
        law = aperture["power_law"]["kappa_paper"]
        fitted = f"b = {law['exponent']:.2f}, r² = {law['r_squared']:.2f}" if law else "too few windows"
        rank = aperture["spearman_with_abs_error"]
        console.print(
            f"{aperture['extent_m']:g} m: kappa_paper {fitted}, "
            f"Spearman {rank['kappa_paper']:.2f} (ours {rank['ours']:.2f})"
        )
    console.print(f"Metrics: [bold]{options.out / METRICS}[/], picture: [bold]{options.out / PICTURE}[/]")
    return 0
