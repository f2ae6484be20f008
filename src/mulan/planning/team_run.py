"""A team's next views on a run folder: the run's photographs teach small fields, their disagreement plans."""

from collections.abc import Callable
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
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.learn_in_memory import learn_in_memory
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import UncertaintyWeights

SMALL_FIELD = FieldConfig(log2_table_size=14, finest_resolution=64, harmonics_degree=1)
"""Sizes of a field that is learnt in a second to plan with."""


@dataclass(frozen=True)
class EnsembleConfig:
    """Small fields whose disagreement tells what is not known yet."""

    members: int = 3
    """Fields; below 2 only directions and visibility plan, by the run's own field."""
    steps: int = 400
    """Optimiser steps of each."""
    image_size: int = 100
    """Longest image side they learn from, in pixels."""


@dataclass(frozen=True)
class TeamRunConfig:
    """How the next views of a run's robots are chosen."""

    team: TeamPlanConfig = field(default_factory=TeamPlanConfig)
    """Candidates, and what a team weighs."""
    ensemble: EnsembleConfig = field(default_factory=EnsembleConfig)
    """What is asked for what is not known."""
    looks: LookConfig = field(default_factory=LookConfig)
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
    robots = last_views(images)
    if progress is not None:
        progress(0, len(robots), "small fields learn")
    fields = learnt_ensemble(images, space, config.ensemble) or [engine]
    chosen = [
        View(
            image.camera,
            image.T_world_camera,
            np.zeros((6, 6)) if image.pose_covariance is None else image.pose_covariance,
        )
        for image in images.train
    ]
    knowledge = Knowledge(fields, space, chosen, config.looks)
    plan = plan_team(knowledge, engine, robots, looked_at_m(images), config.team, progress=progress)
    write_plan(run, images, plan, engine)
    return plan


def learnt_ensemble(images: PosedImageSet, space: SceneSpace, config: EnsembleConfig) -> list[RadianceEngine]:
    """Small fields of the training photographs, each from its own start; none below two members."""
    if config.members < 2:
        return []
    training = TrainConfig(
        image_size=config.image_size, steps=config.steps, device=Device.CPU, field=SMALL_FIELD
    )
    photographs = load_captured(images.train, config.image_size)
    return [
        learn_in_memory(photographs, UncertaintyWeights(), space, replace(training, seed=member))
        for member in range(config.members)
    ]
