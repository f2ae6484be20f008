"""All parts of the evaluation: run, judge, write."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.localization.cases import CasesConfig, Progress, judged, run_cases
from mulan.evaluation.localization.picture import draw_cases, draw_example
from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import RunFolder, read_json, write_json

PARTS = ("cases", "real", "online")
CASES_PICTURE, EXAMPLE_PICTURE = "cases.png", "example.png"


@dataclass(frozen=True)
class EvaluationConfig:
    """What is measured."""

    data: Path
    """Folder of the recordings; only the real part reads it."""
    only: tuple[str, ...] = PARTS
    """Parts to run."""
    cases: CasesConfig = field(default_factory=CasesConfig)
    """Size of the simulation."""


def chosen_parts(only: str) -> tuple[str, ...]:
    """Parts named in a list separated by commas; none named means all.

    Raises:
        InputError: A part is unknown.
    """
    parts = tuple(part.strip() for part in only.split(",") if part.strip())
    for part in parts:
        if part not in PARTS:
            raise InputError("--only", f"part '{part}'", "is unknown", f"choose from {', '.join(PARTS)}")
    return parts or PARTS


def run_real(data: Path, progress: Progress) -> dict[str, Any]:  # noqa: ARG001 (to be filled)
    """Every real recording by name; one that lies not in ``data`` is said to be not available."""
    return {}


def run_online(progress: Progress) -> dict[str, Any]:  # noqa: ARG001 (to be filled)
    """The incremental solver at the pace of a mission."""
    return {}


def evaluate_localization(
    config: EvaluationConfig, run: RunFolder, stage: Callable[[str], Progress]
) -> dict[str, Any]:
    """Measure the chosen parts, write ``metrics.json`` after each, and the pictures.

    Parts of an earlier ``metrics.json`` that this call does not measure are kept, each with its provenance.

    Raises:
        InputError: The folder cannot be written, or a recording cannot be read.
    """
    run.check_writable()
    command = "mulan evaluate localization"
    metrics: dict[str, Any] = read_json(run.metrics, command) if run.metrics.exists() else {}

    def keep(part: str, measured: dict[str, Any]) -> None:
        metrics[part] = measured
        metrics["provenance"] = metrics.get("provenance", {}) | {part: provenance(config.cases.seed)}
        write_json(run.metrics, metrics)

    if "cases" in config.only:
        measured = run_cases(config.cases, stage("Simulating teams"))
        metrics |= {"config": asdict(config.cases), "goals": judged(measured)}
        keep("cases", measured)
        draw_cases(measured, run.root / CASES_PICTURE)
        draw_example(config.cases.noise, config.cases.seed, run.root / EXAMPLE_PICTURE)
    if "real" in config.only:
        keep("real", run_real(config.data, stage("Real recordings")))
    if "online" in config.only:
        keep("online", run_online(stage("Online")))
    return metrics
