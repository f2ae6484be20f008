"""``mulan evaluate view-selection``: rules for choosing views, side by side."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import tyro
from tyro.conf import EnumChoicesFromValues

from mulan.cli.evaluate_engine import recordings
from mulan.cli.paired_gains import paired_gains_table
from mulan.cli.progress import console, progress_stages
from mulan.errors import InputError
from mulan.evaluation.view_selection.fields import FieldsConfig
from mulan.evaluation.view_selection.policies import TITLES
from mulan.evaluation.view_selection.pools import PoolKind
from mulan.evaluation.view_selection.protocol import PICTURE, ViewSelectionConfig, view_selection
from mulan.evaluation.view_selection.trial import TrialConfig
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import RunFolder

QUICK_STEPS, QUICK_PLANNING_STEPS = 500, 150


@dataclass(frozen=True)
class Options:
    """Choose views from a set of photographs by every rule, learn from them, compare with the rest."""

    out: Path
    """Folder to write: metrics.json, view_selection.png, a folder a seed."""
    data: Path = field(default_factory=lambda: recordings() / "nerf_synthetic_lego")
    """Posed image set: a folder or transforms.json (Blender, nerfstudio, instant-ngp)."""
    hold_out_every: int = 8
    """Every n-th image becomes a test view where the set names none."""
    views: str = "5,10,20"
    """Numbers of views at which a field is learnt from scratch and judged, separated by commas."""
    first_views: int = 4
    """Views every policy starts from, drawn by lot; 2 with --views 10 is FisherRF's other schedule."""
    seeds: int = 5
    """Repetitions; each draws its own first views, windows, pose errors and fields."""
    first_seed: int = 0
    """Seed of the first repetition."""
    members: int = 5
    """Fields of the ensemble whose variance is judged for 'ours'; its rule plans with three of them."""
    pool: EnumChoicesFromValues[PoolKind] = PoolKind.STANDARD
    """What is wrong with the photographs: nothing; half the field of view, pointed at random; half of them
    with a position error of 0.15 m; all with one of 0.02 m to 0.08 m."""
    policies: str = ""
    """Policies to compare, separated by commas; those the pool is made for if empty. Those finished earlier
    with the same options are shown too."""
    image_size: int = 100
    """Longest image side in pixels."""
    steps: int | None = None
    """Optimiser steps of each field that is judged; 2500 if not given."""
    planning_steps: int | None = None
    """Optimiser steps of each field that plans; 300 if not given."""
    distortion_weight: float = 0.0
    """What weight scattered along a ray costs every field; 0.1 helps where photographs overlap little
    (--pool narrow). 0: as chosen for the kind of scene."""
    round_views: int = 2
    """Views chosen between two looks at what was learnt."""
    quick: bool = False
    """500 steps, 150 to plan, unless given: a look, no measurement."""


def comparison(options: Options) -> ViewSelectionConfig:
    """What the options ask for.

    Raises:
        InputError: ``--views`` is not a list of numbers, or a number is not positive.
    """
    try:
        views = tuple(int(word) for word in options.views.split(","))
    except ValueError:
        raise InputError(
            "--views", f"'{options.views}'", "is not a list of whole numbers", "give some such as 5,10,20"
        ) from None
    steps, planning = (QUICK_STEPS, QUICK_PLANNING_STEPS) if options.quick else (None, None)
    default = FieldsConfig()
    fields = FieldsConfig(
        image_size=options.image_size,
        steps=options.steps or steps or default.steps,
        planning_steps=options.planning_steps or planning or default.planning_steps,
        distortion_weight=options.distortion_weight,
    )
    for option, value in (
        ("--steps", fields.steps),
        ("--planning-steps", fields.planning_steps),
        ("--image-size", fields.image_size),
        ("--round-views", options.round_views),
    ):
        if value < 1:
            raise InputError(option, "value", f"{value} is below one", "give one or more")
    if not 0 <= options.distortion_weight < math.inf:
        problem = f"{options.distortion_weight} is not a cost"
        raise InputError("--distortion-weight", "value", problem, "give zero or more, such as 0.1")
    if options.members < 3:
        raise InputError("--members", "value", f"{options.members} is below three", "give three or more")
    trial = TrialConfig(
        views=views,
        first_views=options.first_views,
        round_views=options.round_views,
        fields=fields,
        members=options.members,
    )
    policies = tuple(word.strip() for word in options.policies.split(",") if word.strip())
    return ViewSelectionConfig(options.pool, options.seeds, options.first_seed, policies, trial)


def print_comparison(metrics: dict[str, Any]) -> None:
    """PSNR at every number of views with the paired gains, and how well the variance ranks the error."""
    policies = metrics["policies"]
    console.print(paired_gains_table(policies, TITLES, "views"))
    console.print(
        "[dim]mean PSNR of the test views in dB; paired gains with 95 % interval; ms a candidate[/]"
    )
    for name, policy in policies.items():
        for count, at in policy["views"].items():
            if "ause" in at:
                ause, rank = at["ause"], at["spearman"]
                console.print(
                    f"[dim]{TITLES[name]}, {count} views, object pixels, AUSE and Spearman:"
                    f" ensemble {ause['ensemble']:.2f}, {rank['ensemble']:.2f};"
                    f" learned {ause['learned']:.2f}, {rank['learned']:.2f};"
                    f" by lot AUSE {ause['chance']:.2f}[/]"
                )


def main(arguments: Sequence[str]) -> int:
    """Choose, learn, judge, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate view-selection")
    config = comparison(options)
    images = read_posed_images(options.data, options.hold_out_every)
    run = RunFolder(options.out)
    with progress_stages() as stage:
        metrics = view_selection(images, config, run, stage, console.print)
    run.record_config("evaluate view-selection", asdict(options))
    print_comparison(metrics)
    console.print(f"Metrics: [bold]{run.metrics}[/], picture: [bold]{run.root / PICTURE}[/]")
    return 0
