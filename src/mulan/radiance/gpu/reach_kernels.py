"""Which samples are worth a colour: those that light reaches and that are not nearly empty, packed anew."""

from dataclasses import dataclass
from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.gpu.composite_kernels import alpha_of, reach_of
from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.gpu.march_kernels import MarchedRays
from mulan.radiance.gpu.random_kernels import EXPLORING, split_seed, uniform
from mulan.radiance.gpu.space_kernels import SceneArguments, step_in_radii


@dataclass(frozen=True)
class ReachedSamples:
    """The samples worth a colour, packed ray by ray; how many there are is known to the device alone.

    Attributes:
        offsets: Where each ray's samples begin, and the end of the last.
        source: Where each sample was among the marched ones.
        ray: Its ray.
        distance_m: Distance along the ray.
        density: Per scene radius.
        unit: Unit-cube coordinates, one row an axis.
    """

    offsets: Int[Tensor, "r1"]
    source: Int[Tensor, "room"]
    ray: Int[Tensor, "room"]
    distance_m: Float[Tensor, "room"]
    density: Float[Tensor, "room"]
    unit: Float[Tensor, "3 room"]

    @property
    def count(self) -> Int[Tensor, "1"]:
        """How many there are."""
        return self.offsets[-1:]


@triton.jit(do_not_specialize=["rays", "first_ray", "seed_low", "seed_high", "least_opacity", "exploring"])
@no_type_check
def reach_kernel(
    offsets,
    distance,
    density,
    rank_out,
    kept_out,
    rays,
    first_ray,
    seed_low,
    seed_high,
    least_opacity,
    exploring,
    min_transmittance,
    radius,
    step,
    near,
    growth,
    UNBOUNDED: tl.constexpr,
    DIMENSION: tl.constexpr,
    R: tl.constexpr,
    S: tl.constexpr,
):
    """Rank of each sample among its ray's kept ones, -1 for a dropped one, and how many are kept."""
    ray = tl.program_id(0) * R + tl.arange(0, R)
    on = ray < rays
    start = tl.load(offsets + ray, mask=on, other=0)
    count = tl.load(offsets + ray + 1, mask=on, other=0) - start
    least = tl.zeros([R], tl.float32) + least_opacity
    explores = uniform(seed_low, seed_high, ray + first_ray, DIMENSION) < exploring
    least = tl.where(explores, 0.0, least)[:, None]
    before = tl.zeros([R], tl.float32)
    kept = tl.zeros([R], tl.int32)
    for first in range(0, tl.max(count, 0), S):
        k = first + tl.arange(0, S)[None, :]
        at, here = start[:, None] + k, k < count[:, None]
        t = tl.load(distance + at, mask=here, other=0.0)
        depth = tl.load(density + at, mask=here, other=0.0)
        depth *= step_in_radii(t, radius, step, near, growth, UNBOUNDED)
        thick = alpha_of(depth) >= least
        reach, _, before = reach_of(tl.where(thick, depth, 0.0), before)
        keep = (here & thick & (reach > min_transmittance)).to(tl.int32)
        rank = kept[:, None] + tl.cumsum(keep, 1) - 1
        tl.store(rank_out + at, tl.where(keep != 0, rank, -1), mask=here)
        kept += tl.sum(keep, 1)
    tl.store(kept_out + ray, kept, mask=on)


@triton.jit(do_not_specialize=["n"])
@no_type_check
def pack_kernel(
    rank,
    offsets,
    ray_in,
    distance_in,
    density_in,
    unit_in,
    source,
    ray_out,
    distance_out,
    density_out,
    unit_out,
    n,
    room,
    B: tl.constexpr,
):
    """Moves the kept samples to their places."""
    i = tl.program_id(0) * B + tl.arange(0, B)
    kept_rank = tl.load(rank + i, mask=i < n, other=-1)
    on = kept_rank >= 0
    ray = tl.load(ray_in + i, mask=on, other=0)
    to = tl.load(offsets + ray, mask=on, other=0) + kept_rank
    tl.store(source + to, i, mask=on)
    tl.store(ray_out + to, ray, mask=on)
    tl.store(distance_out + to, tl.load(distance_in + i, mask=on, other=0.0), mask=on)
    tl.store(density_out + to, tl.load(density_in + i, mask=on, other=0.0), mask=on)
    for axis in tl.static_range(3):
        value = tl.load(unit_in + axis * room + i, mask=on, other=0.0)
        tl.store(unit_out + axis * room + to, value, mask=on)


def keep_reached(
    marched: MarchedRays,
    density: Float[Tensor, "room"],
    scene: SceneArguments,
    config: TritonConfig,
    least_opacity: float,
    exploring_share: float = 0.0,
    seed: int = 0,
    first_ray: int = 0,
) -> ReachedSamples:
    """The samples that at least ``min_transmittance`` of the light reaches and that are not too thin.

    Args:
        marched: All samples.
        density: Theirs, per scene radius.
        scene: Step lengths and least transmittance.
        config: How to run.
        least_opacity: Samples thinner than this count as empty; 0 = none do.
        exploring_share: Share of rays to which that bound does not apply, drawn by ``seed``.
        seed: Of the draw.
        first_ray: Number of the first ray among all that share the seed.
    """
    rays, blocks = len(marched.offsets) - 1, config.blocks
    rank, source, ray = (torch.empty_like(marched.ray) for _ in range(3))
    distance, kept_density, unit = (torch.empty_like(x) for x in (marched.distance_m, density, marched.unit))
    kept, offsets = torch.zeros_like(marched.offsets[1:]), torch.zeros_like(marched.offsets)
    if rays:
        reach_kernel[(programs(rays, blocks.rays),)](
            *(marched.offsets, marched.distance_m, density, rank, kept, rays, first_ray),
            *(*split_seed(seed), float(least_opacity), float(exploring_share), scene.min_transmittance),
            *(scene.radius_m, scene.step_m, scene.near_m, scene.growth),
            UNBOUNDED=scene.unbounded,
            DIMENSION=EXPLORING,
            R=blocks.rays,
            S=blocks.steps,
        )
    torch.cumsum(kept, 0, dtype=torch.int32, out=offsets[1:])
    reached = ReachedSamples(offsets, source, ray, distance, kept_density, unit)
    if marched.samples:
        pack_kernel[(programs(marched.samples, blocks.samples),)](
            *(rank, offsets, marched.ray, marched.distance_m, density, marched.unit),
            *(source, ray, distance, kept_density, unit, marched.samples, len(source)),
            B=blocks.samples,
        )
    return reached
