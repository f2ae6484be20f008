"""A team's next views on a run folder: the run's photographs teach small fields, their disagreement plans."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.planning.knowledge import Knowledge, LookConfig
from mulan.planning.plan import ViewPlan
from mulan.planning.run_files import last_views, looked_at_m, photographed, write_plan
from mulan.planning.team_plan import TeamPlanConfig, plan_team
from mulan.planning.view import View
from mulan.radiance.backend import Device
from mulan.radiance.config import FieldConfig
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.field_choice import choose_march
from mulan.reconstruction.learn_in_memory import learn_in_memory
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import UncertaintyWeights

SMALL_FIELD = FieldConfig(log2_table_size=14, finest_resolution=64, harmonics_degree=1)
"""Sizes of a field that is learnt in a second to plan with."""
_TEAM_FIELD = FieldConfig(levels=5, log2_table_size=14, finest_resolution=64, harmonics_degree=1)
_FEW_STEPS = 64  # along a ray; finer ones see the same cells, and learn no better in so short a time
# a robot placed badly would else be left out altogether, and what it saw be planned for again
_WEIGHTS = UncertaintyWeights(most_sigma_px=math.inf)
TEAM_LOOKS = LookConfig(columns=16, chosen_columns=32, certainty_columns=6)
"""Rays enough to tell candidates apart: two robots' 160 are judged in two seconds on one core."""


@dataclass(frozen=True)
class EnsembleConfig:
    """Small fields whose disagreement tells what is not known yet."""

    members: int = 3
    """Fields; below 2 only directions and visibility plan, by the run's own field."""
    steps: int = 150
    """Optimiser steps of each."""
    batch_samples: int = 4096
    """Field evaluations a step."""
    image_size: int = 100
    """Longest image side they learn from, in pixels."""


@dataclass(frozen=True)
class TeamRunConfig:
    """How the next views of a run's robots are chosen."""

    team: TeamPlanConfig = field(default_factory=TeamPlanConfig)
    """Candidates, and what a team weighs."""
    ensemble: EnsembleConfig = field(default_factory=EnsembleConfig)
    """What is asked for what is not known."""
    looks: LookConfig = TEAM_LOOKS
    """Rays of a look."""


def plan_team_run(
    run: RunFolder,
    engine: RadianceEngine,
    space: SceneSpace,
    config: TeamRunConfig,
    progress: Callable[[int, int, str], None] | None = None,
) -> ViewPlan:
    """Choose the next view of every robot of a run together; writes plan.json and plan.png.

    Raises:
        InputError: transforms.json is missing or cannot be used, or a photograph cannot be read.
    """
    images = photographed(run)
    plan, _ = plan_team_images(
        images,
        [robot.robot for robot in last_views(images)],
        None,
        config.team,
        config.ensemble,
        config.looks,
        (engine, space),
        progress,
    )
    write_plan(run, images, plan, engine)
    return plan


def plan_team_images(
    images: PosedImageSet,
    names: Sequence[str],
    budget_m: Sequence[float] | None,
    team: TeamPlanConfig,
    ensemble: EnsembleConfig,
    looks: LookConfig,
    trained: tuple[RadianceEngine, SceneSpace] | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> tuple[ViewPlan, Knowledge]:
    """Choose the next view of some robots together from photographs alone.

    Args:
        images: Photographs with believed poses, of all robots.
        names: Robots to plan for, each from its last photograph.
        budget_m: How far each may still travel; without end if not given.
        team: Candidates, and what a team weighs.
        ensemble: The small fields.
        looks: Rays of a look.
        trained: A field of these photographs and where its scene is; the small fields stand in without it.
        progress: Called with (done, total, what).

    Returns:
        The plan and what it was made from.

    Raises:
        InputError: A photograph cannot be read.
        ValueError: Neither a trained field nor two small ones are asked for.
    """
    robots = [robot for robot in last_views(images) if robot.robot in names]
    robots.sort(key=lambda robot: names.index(robot.robot))
    if progress is not None:
        progress(0, len(robots), "small fields learn")
    photographs = load_captured(images.train, ensemble.image_size)
    engine, space = trained or (None, choose_space(photographs))
    fields = learnt_ensemble(photographs, space, ensemble) if ensemble.members > 1 else []
    fields = fields or ([engine] if engine is not None else [])
    if not fields:
        raise ValueError("planning needs a trained field or an ensemble of at least two")
    knowledge = Knowledge(fields, space, chosen_views(images), looks)
    obstacles = engine or fields[0]
    plan = plan_team(knowledge, obstacles, robots, looked_at_m(images), team, budget_m, progress)
    return plan, knowledge


def chosen_views(images: PosedImageSet) -> list[View]:
    """Where the training photographs were taken; a pose without covariance counts as exact."""
    return [
        View(
            image.camera,
            image.T_world_camera,
            np.zeros((6, 6)) if image.pose_covariance is None else image.pose_covariance,
        )
        for image in images.train
    ]


def learnt_ensemble(
    photographs: Sequence[CapturedImage], space: SceneSpace, config: EnsembleConfig
) -> list[RadianceEngine]:
    """Small fields of the photographs, each from its own start."""
    march = choose_march(config.image_size, space.unbounded)
    training = TrainConfig(
        image_size=config.image_size,
        steps=config.steps,
        batch_samples=config.batch_samples,
        device=Device.CPU,
        field=_TEAM_FIELD,
        march=replace(march, steps=_FEW_STEPS, occupancy_resolution=32),
    )
    return [
        learn_in_memory(photographs, _WEIGHTS, space, replace(training, seed=member))
        for member in range(config.members)
    ]
