"""The whole comparison: every policy of every seed, metrics.json after each, the picture at the end."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.provenance import provenance
from mulan.evaluation.view_selection.picture import draw
from mulan.evaluation.view_selection.policies import POLICIES, TITLES, Policy
from mulan.evaluation.view_selection.pools import PoolKind, PoolSource
from mulan.evaluation.view_selection.summary import summarise
from mulan.evaluation.view_selection.trial import (
    FirstFields,
    Progress,
    TrialConfig,
    finished_trial,
    made_from,
    run_trial,
)
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json

PICTURE = "view_selection.png"


@dataclass(frozen=True)
class ViewSelectionConfig:
    """What is compared."""

    kind: PoolKind = PoolKind.STANDARD
    """What is wrong with the photographs."""
    seeds: int = 5
    """Repetitions; each draws its own first views, windows, pose errors and fields."""
    first_seed: int = 0
    """Seed of the first repetition. 0 to 19 are published; options are tried out on 100 and above."""
    policies: tuple[str, ...] = ()
    """Names of the policies; those the pool is made for if empty."""
    trial: TrialConfig = field(default_factory=TrialConfig)
    """How views are chosen and judged."""


def view_selection(
    images: PosedImageSet,
    config: ViewSelectionConfig,
    run: RunFolder,
    stage: Callable[[str], Progress],
    say: Callable[[str], object],
) -> dict[str, Any]:
    """Choose, learn and judge; an interrupted comparison goes on where it stopped.

    All policies of a seed start from the same views, choose from the same pool and are judged by fields of
    the same seed.

    Args:
        images: The set at its true poses; its test images judge.
        config: What to compare.
        run: Each seed gets a folder below with one file a policy.
        stage: Called with a stage's title, gives the callback that follows its progress.
        say: Called with each result, in a few words.

    Returns:
        What it writes to metrics.json, see :func:`mulan.evaluation.view_selection.summary.summarise`; with
        ``pool``, ``image_set``, ``provenance``.

    Raises:
        InputError: A policy is unknown, an option makes no sense, or the images cannot be used.
    """
    chosen = _chosen(config)
    source = PoolSource(images, config.kind, config.trial.fields.image_size)
    _check(config, len(source), images)
    run.check_writable()
    seeds: dict[int, dict[str, dict[str, Any]]] = {}
    metrics: dict[str, Any] = {}

    def write() -> None:
        metrics.update(summarise(seeds, tuple(TITLES), config.trial.views))
        metrics["pool"], metrics["image_set"] = config.kind.value, images.source.name
        metrics["provenance"] = provenance(config.first_seed) | {"seeds": sorted(seeds)}
        write_json(run.metrics, metrics)

    digest = _digest(images)
    for seed in range(config.first_seed, config.first_seed + config.seeds):
        folder = RunFolder(run.root / f"seed_{seed}")
        first = FirstFields(source.pool(seed), seed, config.trial)
        origin = f"{digest} {config.kind.value}"
        made = {policy.name: made_from(origin, policy, first) for policy in POLICIES}
        # those finished earlier first, so that the table is complete from the start
        seeds[seed] = figures = {}
        for policy in POLICIES:
            if found := finished_trial(made[policy.name], policy, folder):
                figures[policy.name] = found
        for policy in chosen:
            if policy.name in figures:
                continue
            progress = stage(f"Seed {seed}: {policy.title}")
            figures[policy.name] = found = run_trial(policy, first, made[policy.name], folder, progress)
            psnr = ", ".join(f"{one['psnr_db']:.2f}" for one in found["observations"].values())
            say(f"seed {seed}, {policy.title}: {psnr} dB")
            write()
    write()
    draw(metrics, TITLES, run.root / PICTURE)
    return metrics


def _chosen(config: ViewSelectionConfig) -> Sequence[Policy]:
    for name in config.policies:
        if name not in TITLES:
            raise InputError(
                "--policies", f"policy '{name}'", "is unknown", f"choose from {', '.join(TITLES)}"
            )
    if config.policies:
        return [policy for policy in POLICIES if policy.name in config.policies]
    return [policy for policy in POLICIES if config.kind in policy.pools]


def _check(config: ViewSelectionConfig, candidates: int, images: PosedImageSet) -> None:
    trial = config.trial
    if config.seeds < 1:
        raise InputError("--seeds", "value", f"{config.seeds} is below one", "give one or more")
    if not trial.views or list(trial.views) != sorted(set(trial.views)):
        raise InputError("--views", "numbers", "are not in rising order", "give some such as 5,10,20")
    if trial.first_views < 1 or trial.first_views > trial.views[0]:
        problem = f"{trial.first_views} is not between 1 and the first of --views ({trial.views[0]})"
        raise InputError("--first-views", "value", problem, "start from fewer views")
    most = candidates // 2 if config.kind.has_noise else candidates
    if trial.views[-1] > candidates or trial.first_views > most:
        problem = f"{candidates} are too few for {trial.views[-1]} views"
        raise InputError(images.source, "training images", problem, "ask for fewer with --views")


def _digest(images: PosedImageSet) -> str:
    digest = hashlib.sha256()
    for image in (*images.train, *images.test):
        digest.update(f"{image.path.name} {image.path.stat().st_size} {image.camera}".encode())
        digest.update(image.T_world_camera.tobytes())
    return digest.hexdigest()[:16]
