"""The whole table: every setup of every seed, metrics.json after each, the pictures at the end."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.image_metrics.flip import FlipJudge
from mulan.evaluation.image_metrics.lpips import LpipsJudge
from mulan.evaluation.image_metrics.variance_calibration import VarianceJudge
from mulan.evaluation.provenance import provenance
from mulan.evaluation.table1.picture import draw_bars, draw_views
from mulan.evaluation.table1.setups import SETUPS, Setup
from mulan.evaluation.table1.sources import Progress, TeamSource
from mulan.evaluation.table1.summary import SetupFigures, summarise
from mulan.evaluation.table1.trained_setup import finished_setup, trained_setup
from mulan.mission.run_folder import RunFolder, write_json
from mulan.reconstruction.train_config import TrainConfig

BARS, VIEWS = "psnr.png", "views.png"
TITLES = {setup.name: setup.title for setup in SETUPS}


@dataclass(frozen=True)
class Table1Config:
    """What is compared and how long it learns."""

    seeds: int = 5
    """Repetitions; each draws its own noise, split and field."""
    first_seed: int = 0
    """Seed of the first repetition."""
    only: tuple[str, ...] = ()
    """Setups to learn; all if empty. Those finished earlier with the same options are shown too."""
    training: TrainConfig = field(default_factory=TrainConfig)
    """Options of every training but its seed."""
    lpips_weights: Path | None = None
    """File of AlexNet's weights; torch's cache if not given."""


def table1(
    source: TeamSource,
    config: Table1Config,
    run: RunFolder,
    stage: Callable[[str], Progress],
    say: Callable[[str], object],
) -> dict[str, Any]:
    """Learn and score; an interrupted table goes on where it stopped.

    Args:
        source: Makes the team of each seed.
        config: What to compare.
        run: Each seed gets a folder below, each setup one below that.
        stage: Called with a stage's title, gives the callback that follows its progress.
        say: Called with each result, in a few words.

    Returns:
        What it writes to metrics.json, see :func:`mulan.evaluation.table1.summary.summarise`; with
        ``unavailable`` (why a figure is None) and ``provenance``.

    Raises:
        InputError: A setup is unknown, a set of photographs cannot be used, or the folder not written.
    """
    chosen = _chosen(config.only)
    if config.seeds < 1:
        raise InputError("--seeds", "value", f"{config.seeds} is below one", "give one or more")
    run.check_writable()
    lpips, flip = LpipsJudge(config.lpips_weights), FlipJudge()
    judges = (lpips, flip, VarianceJudge())
    why_not = {"lpips": lpips.why_not, "flip": flip.why_not}
    seeds: dict[int, SetupFigures] = {}
    metrics: dict[str, Any] = {}

    def write() -> None:
        metrics.update(summarise(seeds, tuple(TITLES)))
        metrics["unavailable"] = {name: reason for name, reason in why_not.items() if reason}
        metrics["provenance"] = provenance(config.first_seed) | {"seeds": sorted(seeds)}
        write_json(run.metrics, metrics)

    for seed in range(config.first_seed, config.first_seed + config.seeds):
        folder = RunFolder(run.root / f"seed_{seed}")
        team = source.team(seed, folder, stage(f"Seed {seed}: photographs and poses"))
        if not team.true.test:
            raise InputError(team.true.source, "test images", "there are none to score", "name another set")
        training = replace(config.training, seed=seed)
        # those finished earlier first, so that the table is complete from the start
        seeds[seed] = figures = {}
        for setup in SETUPS:
            if found := finished_setup(setup, team, training, _folder(folder, setup)):
                figures[setup.name] = found
        for setup in chosen:
            if setup.name in figures:
                continue
            progress = stage(f"Seed {seed}: {setup.title}")
            figures[setup.name] = found = trained_setup(
                setup, team, training, _folder(folder, setup), judges, progress
            )
            doubted = len(found["doubted"])
            told = f", {doubted} images could not be registered and were left out" if doubted else ""
            say(f"seed {seed}, {setup.title}: {found['psnr_db']:.2f} dB{told}")
            write()
    write()
    draw_bars(metrics, TITLES, run.root / BARS)
    first = RunFolder(run.root / f"seed_{config.first_seed}")
    shown = {setup.name: _folder(first, setup) for setup in SETUPS if setup.name in seeds[config.first_seed]}
    draw_views(shown, TITLES, run.root / VIEWS)
    return metrics


def _folder(seed: RunFolder, setup: Setup) -> RunFolder:
    return RunFolder(seed.root / setup.name)


def _chosen(only: Sequence[str]) -> tuple[Setup, ...]:
    for name in only:
        if name not in TITLES:
            raise InputError("--only", f"setup '{name}'", "is unknown", f"choose from {', '.join(TITLES)}")
    return tuple(setup for setup in SETUPS if not only or setup.name in only)
