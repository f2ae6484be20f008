"""Growing errors of a whole robot: what refinement makes of each, beside true and uncorrected poses."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.convergence.picture import draw_convergence
from mulan.evaluation.provenance import provenance
from mulan.evaluation.table1.pose_noise import RigidNoiseConfig
from mulan.evaluation.table1.setups import SETUPS
from mulan.evaluation.table1.sources import Noise, PaperSource, Progress
from mulan.evaluation.table1.team import Split
from mulan.evaluation.table1.trained_setup import finished_setup, trained_setup
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.reconstruction.train_config import TrainConfig

CONVERGED = 0.95  # share of what uncorrected poses cost that is won back
ERRORS = ((0.2, 4.0), (0.4, 7.0), (0.8, 14.0), (1.2, 21.0), (1.6, 28.0), (2.4, 42.0))
PICTURE = "convergence.png"
_SETUPS = {setup.name: setup for setup in SETUPS}


@dataclass(frozen=True)
class ConvergenceConfig:
    """What is tried and how long it learns."""

    seeds: int = 3
    """Repetitions; each draws its own direction of the error and its own field."""
    errors: tuple[tuple[float, float], ...] = ERRORS
    """Errors of the whole robot: displacement in metres and turn in degrees."""
    split: Split = Split.AZIMUTH
    """Who takes which photograph."""
    training: TrainConfig = field(default_factory=TrainConfig)
    """Options of every training but its seed."""


def convergence(
    images: PosedImageSet,
    config: ConvergenceConfig,
    run: RunFolder,
    stage: Callable[[str], Progress],
    say: Callable[[str], object],
) -> dict[str, Any]:
    """Learn from true, uncorrected and refined poses for every error and seed; goes on where it stopped.

    Args:
        images: The set at its true poses.
        config: What to try.
        run: Every seed gets a folder below, every error one below that.
        stage: Called with a stage's title, gives the callback that follows its progress.
        say: Called with each result, in a few words.

    Returns:
        What it writes to metrics.json: ``errors``, one entry each (see :func:`summary_of`), and
        ``provenance``.

    Raises:
        InputError: There are no test images or no seeds, or the folder cannot be written.
    """
    if config.seeds < 1:
        raise InputError("--seeds", "value", f"{config.seeds} is below one", "give one or more")
    if not images.test:
        raise InputError(images.source, "test images", "there are none to score", "name another set")
    run.check_writable()
    figures: dict[tuple[float, float], list[Mapping[str, Any]]] = {error: [] for error in config.errors}
    metrics: dict[str, Any] = {}
    for seed in range(config.seeds):
        training, folder = replace(config.training, seed=seed), run.root / f"seed_{seed}"
        for error in config.errors:
            displacement_m, turn_deg = error
            rigid = RigidNoiseConfig(displacement_m, turn_deg)
            name = f"{displacement_m:g}m_{turn_deg:g}deg"
            source = PaperSource(images, config.split, Noise.RIGID, rigid=rigid)
            team = source.team(seed, run, stage(f"Seed {seed}, {name}: poses"))
            found = {}
            for setup in (_SETUPS["A"], _SETUPS["B"], _SETUPS["ours"]):
                # true poses are the same whatever the error
                at = RunFolder(folder / (setup.name if setup.name == "A" else f"{name}/{setup.name}"))
                kept = finished_setup(setup, team, training, at)
                follow = stage(f"Seed {seed}, {name}: {setup.title}")
                found[setup.name] = kept or trained_setup(setup, team, training, at, (), follow)
            figures[error].append(found)
            say(f"seed {seed}, {name}: {sentence(found)}")
            metrics["errors"] = [summary_of(error, tried) for error, tried in figures.items() if tried]
            metrics["provenance"] = provenance(0) | {"seeds": list(range(seed + 1))}
            write_json(run.metrics, metrics)
    draw_convergence(metrics["errors"], run.root / PICTURE)
    return metrics


def share_won_back(found: Mapping[str, Any]) -> float:
    """(ours - B)/(A - B); 1 where uncorrected poses cost nothing."""
    oracle, wrong, ours = (found[name]["psnr_db"] for name in ("A", "B", "ours"))
    return (ours - wrong) / (oracle - wrong) if oracle > wrong else 1.0


def sentence(found: Mapping[str, Any]) -> str:
    """One attempt in a few words."""
    verdict = "converged" if share_won_back(found) >= CONVERGED else "did not converge"
    doubted = len(found["ours"]["doubted"])
    told = f"{doubted} images doubted" if doubted else "nothing doubted"
    return f"{found['ours']['psnr_db']:.2f} dB of {found['A']['psnr_db']:.2f}, {verdict}, {told}"


def summary_of(error: tuple[float, float], tried: list[Mapping[str, Any]]) -> dict[str, Any]:
    """All seeds of one error.

    Returns:
        ``displacement_m``, ``turn_deg``; means ``psnr_db`` (A, B, ours), ``gap_recovered`` and
        ``camera_median_m``; ``converged``, the share of the seeds; ``told``, the share of those not converged
        that doubted images, and ``false_alarms``, of those converged (None where there are none);
        ``per_seed``.
    """
    rows = [
        {
            "psnr_db": {name: found[name]["psnr_db"] for name in ("A", "B", "ours")},
            "gap_recovered": share_won_back(found),
            "camera_median_m": found["ours"]["camera_median_m"],
            "doubted": len(found["ours"]["doubted"]),
        }
        for found in tried
    ]
    good = [row for row in rows if row["gap_recovered"] >= CONVERGED]
    bad = [row for row in rows if row["gap_recovered"] < CONVERGED]
    return {
        "displacement_m": error[0],
        "turn_deg": error[1],
        "psnr_db": {name: _mean([row["psnr_db"][name] for row in rows]) for name in ("A", "B", "ours")},
        "gap_recovered": _mean([row["gap_recovered"] for row in rows]),
        "camera_median_m": _mean([row["camera_median_m"] for row in rows]),
        "converged": len(good) / len(rows),
        "told": _mean([float(row["doubted"] > 0) for row in bad]),
        "false_alarms": _mean([float(row["doubted"] > 0) for row in good]),
        "per_seed": rows,
    }


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
