"""The whole table: all policies on paired seeds, written as it grows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.provenance import provenance
from mulan.evaluation.table3.policies import POLICIES, TITLES, Policy
from mulan.evaluation.table3.trial import (
    OBSERVATIONS,
    Start,
    TrialConfig,
    finished_trial,
    made_from,
    run_trial,
)
from mulan.evaluation.view_selection.picture import draw
from mulan.evaluation.view_selection.summary import summarise
from mulan.mission.run_folder import RunFolder, write_json
from mulan.simulation.world import World

PICTURE = "table3.png"

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


@dataclass(frozen=True)
class Table3Config:
    """What is compared."""

    seeds: int = 10
    """Repetitions; each draws its own start, photographs' noise, radio and fields."""
    first_seed: int = 1
    """Seed of the first repetition. 1 to 10 are published; options are tried out on 1000 and above."""
    policies: tuple[str, ...] = ()
    """Names of the policies; the published ones if empty."""
    trial: TrialConfig = field(default_factory=TrialConfig)
    """The schedule."""


def table3(
    config: Table3Config, run: RunFolder, stage: Callable[[str], Progress], say: Callable[[str], object]
) -> dict[str, Any]:
    """Explore by every policy; an interrupted comparison goes on where it stopped.

    All policies of a seed start from the same photographs and are judged by fields of the same seed on the
    same test views.

    Args:
        config: What to compare.
        run: Each seed gets a folder below with one file a policy.
        stage: Called with a stage's title, gives the callback that follows its progress.
        say: Called with each result, in a few words.

    Returns:
        What it writes to metrics.json, see :func:`mulan.evaluation.view_selection.summary.summarise`, with
        ``observations`` for ``views``; besides, ``provenance``.

    Raises:
        InputError: A policy is unknown or an option makes no sense.
    """
    chosen = _chosen(config)
    run.check_writable()
    world: World | None = None
    seeds: dict[int, dict[str, dict[str, Any]]] = {}
    metrics: dict[str, Any] = {}

    def write() -> None:
        metrics.update(summarise(seeds, tuple(TITLES), OBSERVATIONS))
        metrics["provenance"] = provenance(config.first_seed) | {"seeds": sorted(seeds)}
        write_json(run.metrics, _by_observation(metrics))

    for seed in range(config.first_seed, config.first_seed + config.seeds):
        folder = RunFolder(run.root / f"seed_{seed}")
        world = config.trial.scene.build() if world is None else world
        start = Start(world, seed, config.trial)
        digests = {policy.name: made_from(policy, start) for policy in POLICIES}
        # those finished earlier first, so that the table is complete from the start
        seeds[seed] = figures = {}
        for policy in POLICIES:
            if found := finished_trial(digests[policy.name], policy, folder):
                figures[policy.name] = found
        left = [policy for policy in chosen if policy.name not in figures]
        progress = stage(f"Seed {seed}") if left else None
        for done, policy in enumerate(left):
            assert progress is not None
            progress(done, len(left), policy.title)
            figures[policy.name] = found = run_trial(policy, start, digests[policy.name], folder)
            psnr = ", ".join(f"{one['psnr_db']:.2f}" for one in found["observations"].values())
            say(f"seed {seed}, {policy.title}: {psnr} dB")
            write()
        if progress is not None:
            progress(1, 1, "done")
    write()
    draw(metrics, TITLES, run.root / PICTURE, counted="observations")
    return _by_observation(metrics)


def _by_observation(metrics: dict[str, Any]) -> dict[str, Any]:
    """The same figures, counted by what is counted here."""
    policies = {
        name: {("observations" if key == "views" else key): value for key, value in policy.items()}
        for name, policy in metrics["policies"].items()
    }
    return {**metrics, "policies": policies}


def _chosen(config: Table3Config) -> Sequence[Policy]:
    for name in config.policies:
        if name not in TITLES:
            raise InputError(
                "--policies", f"policy '{name}'", "is unknown", f"choose from {', '.join(TITLES)}"
            )
    if config.seeds < 1:
        raise InputError("--seeds", "value", f"{config.seeds} is below one", "give one or more")
    if config.policies:
        return [policy for policy in POLICIES if policy.name in config.policies]
    return [policy for policy in POLICIES if policy.published]
