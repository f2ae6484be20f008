"""All parts of the evaluation: run, judge, write."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.localization.cases import CasesConfig, Progress, judged, run_cases
from mulan.evaluation.localization.online import OnlineEvaluationConfig, draw_online, run_online
from mulan.evaluation.localization.picture import draw_cases, draw_example
from mulan.evaluation.localization.real_euroc import run_euroc_mh, run_euroc_v1
from mulan.evaluation.localization.real_uwb import (
    run_uwb_indoor_chemnitz,
    run_uwb_planar,
)
from mulan.evaluation.localization.real_wsr_position import run_wsr_position
from mulan.evaluation.provenance import provenance
from mulan.mission.run_folder import RunFolder, read_json, write_json

PARTS = ("cases", "real", "online")
CASES_PICTURE, EXAMPLE_PICTURE, ONLINE_PICTURE = "cases.png", "example.png", "online.png"


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


_RECORDINGS: dict[str, tuple[str, Callable[[Path, Path], dict[str, Any]]]] = {
    "euroc_mh": ("euroc_vio", lambda data, picture: run_euroc_mh(data, picture=picture)),
    "euroc_v1": ("euroc_vio", lambda data, picture: run_euroc_v1(data, picture=picture)),
    "wsr_position": ("wsr_aoa", lambda data, picture: run_wsr_position(data, picture=picture)),
    "uwb_planar": ("uwb_planar", lambda data, picture: run_uwb_planar(data, picture=picture)),
    "uwb_indoor_chemnitz": (
        "uwb_indoor_chemnitz",
        lambda data, picture: run_uwb_indoor_chemnitz(data, picture=picture),
    ),
}


def run_real(data: Path, pictures: Path, progress: Progress) -> dict[str, Any]:
    """Every real recording by name; one that lies not in ``data`` is said to be not available."""
    results: dict[str, Any] = {}
    for done, (name, (folder, measure)) in enumerate(_RECORDINGS.items()):
        progress(done, len(_RECORDINGS), name)
        if (data / folder).is_dir():
            results[name] = measure(data, pictures / f"{name}.png")
        else:
            results[name] = f"not available: there is no {folder} in {data}"
    progress(len(_RECORDINGS), len(_RECORDINGS), "done")
    return results


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
        keep("real", run_real(config.data, run.root, stage("Real recordings")))
    if "online" in config.only:
        online, update_ms = run_online(OnlineEvaluationConfig(), stage("Online"))
        keep("online", online)
        draw_online(update_ms, run.root / ONLINE_PICTURE)
    return metrics
