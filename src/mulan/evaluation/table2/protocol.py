"""The second table: every setup of every seed, metrics.json after each, the pictures at the end."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from operator import ge, gt
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.image_metrics.flip import FlipJudge
from mulan.evaluation.image_metrics.lpips import LpipsJudge
from mulan.evaluation.image_metrics.variance_calibration import VarianceJudge
from mulan.evaluation.provenance import provenance
from mulan.evaluation.table1.picture import draw_bars, draw_views
from mulan.evaluation.table1.setups import Setup
from mulan.evaluation.table1.sources import Progress
from mulan.evaluation.table1.summary import SetupFigures, share_won_back, summarise
from mulan.evaluation.table1.team import Team
from mulan.evaluation.table1.trained_setup import finished_setup, trained_setup
from mulan.evaluation.table2.colmap import ColmapConfig, ColmapMap, colmap_map
from mulan.evaluation.table2.colmap_alignment import AlignmentFailedError, between_robots, by_colmap_alone
from mulan.evaluation.table2.hardware import Drift, HardwareSource, at_own_odometry
from mulan.evaluation.table2.setups import BY_RADIO, TITLES, by_colmap
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.reconstruction.train_config import TrainConfig

BARS, VIEWS = "psnr.png", "views.png"
ROBOTS = 2
_ALIGNMENTS = {"E": between_robots, "E_poses": by_colmap_alone}


@dataclass(frozen=True)
class Table2Config:
    """What is compared and how long it learns."""

    seeds: int = 5
    """Repetitions; each draws its own noise and field."""
    drift: Drift = Drift.BOTH
    """Whose odometry drifts in C, D, ours and E."""
    only: tuple[str, ...] = ()
    """Setups to learn; all if empty."""
    training: TrainConfig = field(default_factory=TrainConfig)
    """Options of every training but its seed."""
    colmap: ColmapConfig = field(default_factory=ColmapConfig)
    """Options of COLMAP."""
    lpips_weights: Path | None = None
    """File of AlexNet's weights; torch's cache if not given."""


def table2(
    source: HardwareSource,
    config: Table2Config,
    run: RunFolder,
    stage: Callable[[str], Progress],
    say: Callable[[str], object],
) -> dict[str, Any]:
    """Learn and score; an interrupted table goes on where it stopped.

    Args:
        source: The mission; how many tracks are by motion capture is the setups' affair.
        config: What to compare.
        run: Each seed gets a folder below, each setup one below that.
        stage: Called with a stage's title, gives the callback that follows its progress.
        say: Called with each result, in a few words.

    Returns:
        What it writes to metrics.json: ``setups`` and ``per_seed`` as in the first table; ``gap_recovered``
        ((X - C)/(A - C) of the mean PSNRs, of D and ours); ``order``, which of the paper's inequalities hold;
        ``failed``, by setup and seed why there is none; ``colmap``, what COLMAP placed of each seed;
        ``unavailable`` and ``provenance``.

    Raises:
        InputError: A setup is unknown, the set cannot be flown past, or the folder not written.
    """
    _check(source, config)
    run.check_writable()
    lpips, flip = LpipsJudge(config.lpips_weights), FlipJudge()
    judges = (lpips, flip, VarianceJudge())
    why_not = {"lpips": lpips.why_not, "flip": flip.why_not}
    seeds: dict[int, SetupFigures] = {}
    colmap: dict[str, Any] = {}
    failed: dict[str, dict[str, str]] = {}
    metrics: dict[str, Any] = {}

    def write() -> None:
        metrics.update(summary_of(seeds), colmap=colmap, failed=failed)
        metrics["unavailable"] = {name: reason for name, reason in why_not.items() if reason}
        metrics["provenance"] = provenance(0) | {"seeds": sorted(seeds), "drift": config.drift.value}
        write_json(run.metrics, metrics)

    for seed in range(config.seeds):
        training, flight = replace(config.training, seed=seed), _Flight(source, config, run, seed, stage)
        seeds[seed] = figures = {}
        for name in [name for name in TITLES if not config.only or name in config.only]:
            try:
                setup, team = flight.setup(name)
            except AlignmentFailedError as error:
                failed.setdefault(name, {})[str(seed)] = str(error)
                say(f"seed {seed}, {TITLES[name]}: failed, {error}")
            else:
                at, follow = flight.folder(name), stage(f"Seed {seed}: {setup.title}")
                kept = finished_setup(setup, team, training, at)
                figures[name] = kept or trained_setup(setup, team, training, at, judges, follow)
                say(f"seed {seed}, {setup.title}: {figures[name]['psnr_db']:.2f} dB")
            if flight.colmap is not None:
                colmap[str(seed)] = flight.colmap.record()
            write()
    draw_bars(metrics, TITLES, run.root / BARS)
    first = {name: RunFolder(run.root / "seed_0" / name) for name in seeds[0]}
    draw_views(first, TITLES, run.root / VIEWS)
    return metrics


@dataclass
class _Flight:
    """One seed: the missions, made when a setup needs them."""

    source: HardwareSource
    config: Table2Config
    run: RunFolder
    seed: int
    stage: Callable[[str], Progress]
    colmap: ColmapMap | None = None
    _teams: dict[int, Team] = field(default_factory=dict)
    _odometry: PosedImageSet | None = None

    def folder(self, name: str) -> RunFolder:
        return RunFolder(self.run.root / f"seed_{self.seed}" / name)

    def setup(self, name: str) -> tuple[Setup, Team]:
        """A setup and the team it learns from.

        Raises:
            AlignmentFailedError: COLMAP did not find where the robots are.
        """
        if name not in _ALIGNMENTS:
            captured = ROBOTS if name == "B" else self.config.drift.motion_captured
            return BY_RADIO[name], self._team(captured)
        team = self._team(self.config.drift.motion_captured)
        if self.colmap is None or self._odometry is None:
            mission = self._source(self.config.drift.motion_captured).mission(self.seed)
            self._odometry = at_own_odometry(mission, team.true)
            follow = self.stage(f"Seed {self.seed}: COLMAP")
            folder = self.folder("colmap").root
            self.colmap = colmap_map(team.true, folder, self.config.colmap, self.seed, follow)
        return by_colmap(name, _ALIGNMENTS[name](self.colmap, self._odometry, team.anchor)), team

    def _team(self, captured: int) -> Team:
        if captured not in self._teams:
            at = self.folder(f"mission_{captured}_captured")
            follow = self.stage(f"Seed {self.seed}: {captured} of {ROBOTS} robots by motion capture")
            self._teams[captured] = self._source(captured).team(self.seed, at, follow)
        return self._teams[captured]

    def _source(self, captured: int) -> HardwareSource:
        return replace(self.source, motion_captured=captured)


def summary_of(seeds: Mapping[int, SetupFigures]) -> dict[str, Any]:
    """``setups``, ``per_seed``, ``gap_recovered`` and ``order`` of all seeds."""
    summary = summarise(seeds, tuple(TITLES))
    setups = summary["setups"]
    rivals = [name for name in ("D", "ours") if name in setups]
    return {
        "setups": setups,
        "gap_recovered": {name: share_won_back(seeds, name, "C") for name in rivals},
        "order": order_of({name: setup["psnr_db"]["mean"] for name, setup in setups.items()}),
        "per_seed": summary["per_seed"],
    }


def order_of(psnr_db: Mapping[str, float]) -> dict[str, bool]:
    """Which of A ≥ ours ≥ D > C and ours ≥ B hold, of the setups there are."""
    pairs = (("A", "ours", ge), ("ours", "D", ge), ("D", "C", gt), ("ours", "B", ge))
    return {
        f"{high} {'>' if holds is gt else '>='} {low}": holds(psnr_db[high], psnr_db[low])
        for high, low, holds in pairs
        if high in psnr_db and low in psnr_db
    }


def _check(source: HardwareSource, config: Table2Config) -> None:
    for name in config.only:
        if name not in TITLES:
            raise InputError("--only", f"setup '{name}'", "is unknown", f"choose from {', '.join(TITLES)}")
    if config.seeds < 1:
        raise InputError("--seeds", "value", f"{config.seeds} is below one", "give one or more")
    if not source.images.test:
        raise InputError(source.images.source, "test images", "there are none to score", "name another set")
