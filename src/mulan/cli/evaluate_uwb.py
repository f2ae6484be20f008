"""``mulan evaluate uwb``: calibrated ranges on recordings they were not fitted to."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import tyro
from rich.table import Table

from mulan.cli.evaluate_engine import recordings
from mulan.cli.progress import console
from mulan.evaluation.provenance import provenance
from mulan.evaluation.uwb import picture, protocol
from mulan.mission.run_folder import RunFolder, write_json
from mulan.wireless.range_fit import RangeFitConfig, fit_range_model
from mulan.wireless.recordings.uwb_samples import concatenate


@dataclass(frozen=True)
class Options:
    """Likelihood and coverage of calibrated UWB ranges on held-out trials, beside plain Gaussians."""

    out: Path
    """Folder to write: metrics.json, pictures and the fitted models."""
    data: Path = field(default_factory=recordings)
    """Folder that holds uwb_murp, uwb_planar and uwb_indoor_chemnitz."""
    fit: RangeFitConfig = field(default_factory=RangeFitConfig)
    """How error laws are fitted."""


def evaluate(options: Options) -> dict[str, Any]:
    """Fit, score, draw, write."""
    run = RunFolder(options.out)
    run.check_writable()
    trials = protocol.read_murp(options.data / "uwb_murp")
    planar = protocol.read_planar(options.data / "uwb_planar")
    indoor = protocol.read_indoor(options.data / "uwb_indoor_chemnitz")
    sets = {
        "murp": protocol.murp_splits(trials, options.fit),
        "planar": protocol.planar_splits(planar, options.fit),
        "chemnitz": protocol.chemnitz_splits(indoor, options.fit),
    }
    metrics: dict[str, Any] = {name: protocol.set_metrics(splits) for name, splits in sets.items()}
    metrics["murp"]["pairs"] = protocol.pair_metrics(sets["murp"])
    metrics["murp"]["rejection"] = protocol.outlier_metrics(sets["murp"], trials)
    metrics["provenance"] = provenance(seed=0) | {"note": "nothing is drawn at random"}
    trial, name = protocol.OUTLIER_TRIAL
    if trial in trials:
        model = next(split.model for split in sets["murp"] if split.name == trial)
        first = [pair for pair in trials[trial] if pair.name == name]
        rest = [pair for pair in trials[trial] if pair.name != name]
        if first:
            picture.draw_outliers(model, first[0], rest, run.root / "outliers.png")
    picture.draw_errors(sets, run.root / "errors.png")
    picture.draw_reliability(sets, run.root / "reliability.png")
    everything = concatenate("murp", [concatenate(name, pairs) for name, pairs in trials.items()])
    fit_range_model(everything, options.fit).save(run.root / "murp.json")
    next(s.model for s in sets["planar"] if s.name == "static_deg_0 from dynamic").save(
        run.root / "planar.json"
    )
    write_json(run.metrics, metrics)
    return metrics


def main(arguments: Sequence[str]) -> int:
    """Measure, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate uwb")
    metrics = evaluate(options)
    run = RunFolder(options.out)
    run.record_config("evaluate uwb", asdict(options))
    table = Table(box=None, header_style="dim", padding=(0, 2))
    for heading in ("held out", "68 %", "95 %", "NLL", "Gaussian", "10 cm", "reported σ"):
        table.add_column(heading, justify="left" if heading == "held out" else "right")
    for name in ("murp", "planar", "chemnitz"):
        rows = {name: metrics[name]["all"]}
        rows |= {
            f"  {key}": value
            for part in ("pairs", "splits")
            for key, value in metrics[name].get(part, {}).items()
        }
        for key, row in rows.items():
            ours = row["calibrated"]
            table.add_row(
                key,
                f"{100 * ours['coverage_68']:.0f} %",
                f"{100 * ours['coverage_95']:.0f} %",
                *(f"{row[m]['nll']:.2f}" for m in ("calibrated", "gaussian", "constant", "plain")),
            )
    console.print(table)
    console.print(f"Metrics: [bold]{run.metrics}[/]; pictures beside it")
    return 0
