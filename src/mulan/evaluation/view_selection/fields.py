"""The fields an evaluation learns: small ones to plan with, larger ones to be judged."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from mulan.evaluation.view_selection.pools import Pool
from mulan.planning.team_run import SMALL_FIELD
from mulan.radiance.backend import Device
from mulan.radiance.config import FieldConfig
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.reconstruction.field_choice import choose_optimiser
from mulan.reconstruction.learn_in_memory import learn_in_memory
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import UncertaintyWeights, Weighting

_MEMBER_SEEDS = 1000  # apart, so that members of one seed are no members of another


@dataclass(frozen=True)
class FieldsConfig:
    """How fields are learnt."""

    image_size: int = 100
    """Longest image side in pixels."""
    steps: int = 2500
    """Optimiser steps of the fields that are judged."""
    planning_steps: int = 300
    """Optimiser steps of the fields that plan."""
    planning_samples: int = 4096
    """Field evaluations a step of the fields that plan."""
    planning_field: FieldConfig = SMALL_FIELD
    """Sizes of the fields that plan."""
    weighting: Weighting = field(default_factory=lambda: UncertaintyWeights(most_sigma_px=math.inf))
    """How far photographs of uncertain pose are trusted. None is left out altogether, since some pools
    (the graded one) have no exact pose."""
    judged_field: FieldConfig | None = None
    """Sizes of the fields that are judged; chosen from the number of views if not given."""
    distortion_weight: float = 0.0
    """What weight scattered along a ray costs, in fields that plan and that are judged. Views that overlap
    little leave depth to chance, and it then helps; whole photographs are as well without.
    0: as chosen for the kind of scene."""


def planning_fields(
    pool: Pool, chosen: Sequence[int], members: int, seed: int, config: FieldsConfig
) -> list[RadianceEngine]:
    """Small fields of the chosen photographs, each from its own start."""
    training = TrainConfig(
        image_size=config.image_size,
        steps=config.planning_steps,
        batch_samples=config.planning_samples,
        device=Device.CPU,
        field=config.planning_field,
    )
    return _learn(pool, chosen, members, seed, training, config)


def judged_fields(
    pool: Pool, chosen: Sequence[int], members: int, seed: int, config: FieldsConfig
) -> list[RadianceEngine]:
    """Fields learnt from scratch; the first is what a policy is judged by."""
    training = TrainConfig(
        image_size=config.image_size,
        steps=config.steps,
        device=Device.CPU,
        field=config.judged_field,
    )
    return _learn(pool, chosen, members, seed, training, config)


def _learn(
    pool: Pool,
    chosen: Sequence[int],
    members: int,
    seed: int,
    training: TrainConfig,
    config: FieldsConfig,
) -> list[RadianceEngine]:
    optimiser = choose_optimiser(pool.space.unbounded)
    if all(photograph.alpha is not None for photograph in pool.photographs):
        # few views before one background leave walls of its colour in the air, here and there by chance
        optimiser = OptimiserConfig(table_learning_rate=3e-2, random_background=True)
    if config.distortion_weight:
        optimiser = replace(optimiser, distortion_weight=config.distortion_weight)
    # sorted, so that a field depends on the set and not on the order it was chosen in
    photographs = [pool.photographs[i] for i in sorted(chosen)]
    return [
        learn_in_memory(
            photographs,
            config.weighting,
            pool.space,
            replace(training, seed=_MEMBER_SEEDS * member + seed),
            optimiser,
        )
        for member in range(members)
    ]
