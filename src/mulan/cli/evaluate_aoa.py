"""``mulan evaluate aoa``: our bearings and the authors' on the same recorded links."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import tyro
from rich.markup import escape
from rich.table import Table

from mulan.cli.calibration_option import calibrated
from mulan.cli.evaluate_engine import recordings
from mulan.cli.progress import console, progress_bar
from mulan.evaluation.aoa.folder import link_sets
from mulan.evaluation.aoa.metrics import aoa_metrics
from mulan.evaluation.aoa.pictures import draw_aoa
from mulan.evaluation.aoa.protocol import AoaProtocolConfig, measure_links, write_links
from mulan.evaluation.aoa.scored_link import FailedLink
from mulan.evaluation.aoa.truth import DEFINITIONS
from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import RunFolder, write_json
from mulan.wireless.bearing import BearingConfig
from mulan.wireless.link_bearing import DisplacementSource

_COLUMNS = ("links", "mean", "median", ">20°", "top3", "rank", "68 %", "95 %", "ms")
_LEGEND = (
    "mean, median: azimuth error; >20°, top3: share of links beyond 20°, with one of three hypotheses within "
    "10° (%); rank: Spearman of σ and error; 68 %, 95 %: truths inside those intervals (%)"
)


@dataclass(frozen=True)
class Options:
    """Angle of arrival on recorded links with known geometry: accuracy, ranking and calibration."""

    out: Path
    """Folder to write: metrics.json, links.csv and the pictures."""
    data: Path = field(default_factory=lambda: recordings() / "wsr_aoa")
    """Folder in the WSR layout: every sub-folder with npz/ and reference.csv is a set."""
    sources: tyro.conf.EnumChoicesFromValues[tuple[DisplacementSource, ...]] = AoaProtocolConfig.sources
    """Where the moving antenna's path comes from."""
    workers: int = AoaProtocolConfig.workers
    """Processes, of one thread each."""
    calibration: Path | None = None
    """Calibration of the bearings made by 'mulan calibrate'."""
    bearings: BearingConfig = field(default_factory=BearingConfig)
    """The estimator."""


def _cell(value: float | None, form: str = ".2f", scale: float = 1.0) -> str:
    return "–" if value is None else format(scale * value, form)


def _row(figures: dict[str, Any]) -> list[str]:
    if not figures.get("links"):
        return ["0", *["–"] * (len(_COLUMNS) - 1)]
    return [
        str(figures["links"]),
        _cell(figures["mean_abs_error_deg"], ".1f") + "°",
        _cell(figures["median_abs_error_deg"], ".1f") + "°",
        _cell(figures["over_20deg"], ".0f", 100),
        _cell(figures["top3_within_10deg"], ".0f", 100),
        _cell(figures["spearman"], "+.2f"),
        _cell(figures["coverage_68"], ".0f", 100),
        _cell(figures["coverage_95"], ".0f", 100),
        _cell(figures.get("median_milliseconds"), ".0f"),
    ]


def print_figures(metrics: dict[str, Any]) -> None:
    """Ours above the authors', set by set."""
    table = Table(box=None, header_style="dim", padding=(0, 1))
    table.add_column("", no_wrap=True)
    for heading in _COLUMNS:
        table.add_column(heading, justify="right", no_wrap=True)
    for name, by_source in [*metrics["sets"].items(), ("all", metrics["all"])]:
        theirs = metrics["authors"]["sets"].get(name, metrics["authors"]["all"])
        for source, figures in by_source.items():
            table.add_row(f"[bold]{escape(name)}[/] {source}", *_row(figures))
            if theirs.get(source, {}).get("links"):
                table.add_row("  authors", *_row(theirs[source]), style="dim")
    console.print(table)
    console.print(f"[dim]{_LEGEND}[/]")


def print_failures(failed: Sequence[FailedLink]) -> None:
    """One line a link or file without a bearing."""
    for f in failed:
        where = f"{f.set}: {f.run} {f.link} {f.source}".rstrip()
        console.print(f"[red]failed[/] {escape(where)}: {escape(f.reason)}")


def main(arguments: Sequence[str]) -> int:
    """Measure, write, tell; the exit code says whether every link has a bearing."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate aoa")
    sets = link_sets(options.data)
    run = RunFolder(options.out)
    run.check_writable()
    config = AoaProtocolConfig(
        calibrated(options.bearings, options.calibration), options.sources, options.workers
    )
    began = time.monotonic()
    with progress_bar("Links") as progress:
        measured, failed = measure_links(sets, config, progress)
    links = [m.scored for m in measured]
    metrics = {
        **aoa_metrics(links, failed),
        "failed": [asdict(f) for f in failed],
        "truth": DEFINITIONS,
        "error_truth": {"ours": "origin", "authors": "start"},
        "seconds": time.monotonic() - began,
        # nothing is random; the seed is recorded as everywhere
        "provenance": {**provenance(0), "data": options.data.resolve().name, "options": repr(config)},
    }
    write_links(links, run.root / "links.csv")
    write_json(run.metrics, metrics)
    run.record_config("evaluate aoa", asdict(options))
    pictures = draw_aoa(links, run.root)
    print_figures(metrics)
    print_failures(failed)
    console.print(f"Metrics: [bold]{run.metrics}[/], every link: [bold]{run.root / 'links.csv'}[/]")
    for picture in pictures:
        console.print(f"Picture: [bold]{picture}[/]")
    if links:
        worst = max(links, key=lambda link: abs(link.error_deg))
        file = options.data / worst.set / "npz" / f"{worst.run}.npz"
        console.print(
            f"Next: [cyan]mulan aoa {file} --link {worst.link} --source {worst.source}[/] "
            f"draws the link with the largest error ({abs(worst.error_deg):.0f}°)"
        )
    return 1 if failed else 0
