"""All parts of the evaluation: run, judge, write."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.localization.cases import CasesConfig, Progress, cases_of, finished_cases, judged
from mulan.evaluation.localization.growing_metrics import GrowingMetrics
from mulan.evaluation.localization.online import OnlineEvaluationConfig, draw_online, run_online
from mulan.evaluation.localization.picture import draw_cases, draw_example
from mulan.evaluation.localization.recordings import RECORDINGS, measured_recordings
from mulan.mission.run_folder import RunFolder

PARTS = ("cases", "real", "online")
CASES_PICTURE, EXAMPLE_PICTURE, ONLINE_PICTURE = "cases.png", "example.png", "online.png"


@dataclass(frozen=True)
class EvaluationConfig:
    """What is measured."""

    data: Path
    """Folder of the recordings; only the real part reads it."""
    only: tuple[str, ...] = PARTS
    """Parts to run."""
    recordings: tuple[str, ...] = RECORDINGS
    """Recordings of the real part."""
    cases: CasesConfig = field(default_factory=CasesConfig)
    """Size of the simulation, and the number of processes."""


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


def evaluate_localization(
    config: EvaluationConfig, run: RunFolder, stage: Callable[[str], Progress]
) -> dict[str, Any]:
    """Measure the chosen parts, write ``metrics.json`` after each finished figure, and the pictures.

    Figures of an earlier ``metrics.json`` that this call does not measure are kept, each part with its
    provenance. A run that was interrupted goes on where it stopped when it is called with the same options.

    Raises:
        InputError: The folder cannot be written, or a recording cannot be read.
    """
    kept = GrowingMetrics(run, "mulan evaluate localization", config.cases.seed)
    metrics = kept.metrics
    if "cases" in config.only:
        told = json.loads(json.dumps(asdict(replace(config.cases, workers=1))))
        known = kept.begin("cases", told, keep=metrics.get("config") == told)
        metrics["config"] = told
        for name, figures in finished_cases(config.cases, known, stage("Simulating teams")):
            metrics["goals"] = judged({**metrics["cases"], name: figures})
            kept.add("cases", name, figures)
        kept.end("cases", [case.name for case in cases_of(config.cases)])
        metrics["goals"] = judged(metrics["cases"])
        draw_cases(metrics["cases"], run.root / CASES_PICTURE)
        draw_example(config.cases.noise, config.cases.seed, run.root / EXAMPLE_PICTURE)
    if "real" in config.only:
        known = kept.begin("real", {"recordings": config.recordings}, keep=True)
        names = [name for name in config.recordings if name not in known]
        progress = stage("Real recordings")
        for name, figures in measured_recordings(
            names, config.data, run.root, config.cases.workers, progress
        ):
            kept.add("real", name, figures)
        kept.end("real", RECORDINGS)
    if "online" in config.only:
        kept.begin("online", {}, keep=True)
        online, update_ms = run_online(OnlineEvaluationConfig(), stage("Online"))
        metrics["online"] = online
        kept.end("online")
        draw_online(update_ms, run.root / ONLINE_PICTURE)
    return metrics
