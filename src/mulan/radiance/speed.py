"""How fast a field learns on this machine, measured on a built-in scene."""

import time
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.backend import new_engine
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.space import SceneSpace

SPHERE_RADIUS_M = 0.5
RAYS = 512
WARM_UP_RAYS = 64
WARM_UP_STEPS = 112  # until the occupancy grid leaves out what is empty, if there is the time


@dataclass(frozen=True)
class EngineSpeed:
    """What a training ran at.

    Attributes:
        samples_per_s: Field evaluations marched a second, forward, backward and update.
        rays_per_s: Rays learnt from a second.
    """

    samples_per_s: float
    rays_per_s: float


def measure_training_speed(seconds: float = 1.0) -> EngineSpeed:
    """Learn a coloured sphere before white with the default sizes on the best backend there is.

    Args:
        seconds: How long to measure, after a warm-up of at most twice that; at least one step is made.
    """
    box = SceneSpace((0.0, 0.0, 0.0), 1.0, False)
    engine = new_engine(FieldConfig(), MarchConfig(), box, white_background=True, seed=0)
    generator = torch.Generator().manual_seed(0)
    batches = [sphere_batch(RAYS, generator) for _ in range(8)]
    began = time.perf_counter()
    for _ in range(WARM_UP_STEPS):
        engine.train_step(sphere_batch(WARM_UP_RAYS, generator), 1.0)
        if time.perf_counter() - began > 2 * seconds:
            break
    steps, samples, began = 0, 0, time.perf_counter()
    while steps == 0 or time.perf_counter() - began < seconds:
        samples += engine.train_step(batches[steps % len(batches)], 1.0).samples
        steps += 1
    elapsed = time.perf_counter() - began
    return EngineSpeed(samples / elapsed, steps * RAYS / elapsed)


def sphere_batch(rays: int, generator: torch.Generator) -> RayBatch:
    """Rays from around a sphere that shows its surface position as colour."""
    origins = _unit(torch.randn(rays, 3, generator=generator)) * 3
    targets = (torch.rand(rays, 3, generator=generator) * 2 - 1) * SPHERE_RADIUS_M
    directions = _unit(targets - origins)
    closest = (origins * directions).sum(-1, keepdim=True)
    discriminant = closest**2 - origins.square().sum(-1, keepdim=True) + SPHERE_RADIUS_M**2
    surface = origins + (-closest - discriminant.clamp_min(0).sqrt()) * directions
    colours = torch.where(discriminant > 0, 0.5 + surface / (2 * SPHERE_RADIUS_M), 1.0)
    index = torch.zeros(rays, dtype=torch.int64)
    return RayBatch(origins, directions, colours, torch.ones(rays), index)


def _unit(vectors: Float[Tensor, "r 3"]) -> Float[Tensor, "r 3"]:
    return torch.nn.functional.normalize(vectors, dim=-1)
