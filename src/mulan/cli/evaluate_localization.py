"""``mulan evaluate localization``: poses and covariances against what is possible."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from mulan.cli.evaluate_engine import recordings
from mulan.cli.progress import console, progress_stages
from mulan.evaluation.localization.cases import CasesConfig
from mulan.evaluation.localization.protocol import EvaluationConfig, chosen_parts, evaluate_localization
from mulan.evaluation.localization.recordings import chosen_recordings
from mulan.mission.run_folder import RunFolder


@dataclass(frozen=True)
class Options:
    """Simulated teams beside the Cramér–Rao bound, real recordings, the incremental solver."""

    out: Path
    """Folder to write; metrics.json and pictures lie in it."""
    data: Path = field(default_factory=recordings)
    """Folder of the public recordings; parts whose recordings are absent are said to be not available."""
    only: str = ""
    """Parts to measure, separated by commas (cases, real, online); others in metrics.json are kept."""
    recordings: str = ""
    """Recordings of the real part, separated by commas; none means all, others in metrics.json are kept."""
    quick: bool = False
    """One small team a case: shows that the command works, measures nothing."""
    cases: Annotated[CasesConfig, tyro.conf.arg(name="")] = field(default_factory=CasesConfig)
    """Size of the simulation."""


def _cell(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)


def print_cases(cases: Mapping[str, Mapping[str, Any]]) -> None:
    """The simulated cases as a table."""
    table = Table(box=None, header_style="dim", padding=(0, 2))
    for heading in ("case", "camera RMS", "bound", "ratio", "yaw RMS", "NEES/dof", "trials", "refused"):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    for name, case in cases.items():
        table.add_row(
            name,
            _cell(case["rms_m"], ".4f"),
            _cell(case["bound_m"], ".4f"),
            _cell(case["rms_over_bound"], ".2f"),
            _cell(case["yaw_rms_deg"], ".2f"),
            _cell(case["nees_per_dof"], ".2f"),
            str(case["trials"]),
            str(case["refused"]),
        )
    console.print(table)


def main(arguments: Sequence[str]) -> int:
    """Measure, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate localization")
    cases = options.cases
    if options.quick:
        cases = replace(cases, trials=1, meetings=(5,), fleets=(3,), workers=1)
    run = RunFolder(options.out)
    config = EvaluationConfig(
        options.data, chosen_parts(options.only), chosen_recordings(options.recordings), cases
    )
    with progress_stages() as stage:
        metrics = evaluate_localization(config, run, stage)
    run.record_config("evaluate localization", asdict(options))
    print_cases(metrics.get("cases", {}))
    for name, goal in metrics.get("goals", {}).items():
        console.print(f"{'[green]pass [/]' if goal['result'] == 'pass' else '[red]short[/]'} {name}")
    console.print(f"Metrics: [bold]{run.metrics}[/]; pictures beside it")
    return 0
