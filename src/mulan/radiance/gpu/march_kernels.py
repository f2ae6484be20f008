"""Samples of rays in occupied cells, counted first, then written (reference: ``kernels/march.py``)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Bool, Float, Int
from torch import Tensor

from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.gpu.random_kernels import JITTER, split_seed, uniform
from mulan.radiance.gpu.space_kernels import SceneArguments, to_unit


@dataclass(frozen=True)
class MarchedRays:
    """Samples packed ray by ray, near to far, in arrays with room for more.

    Attributes:
        offsets: Where each ray's samples begin, and the end of the last.
        ray: Ray of each sample.
        distance_m: Distance along the ray.
        unit: Unit-cube coordinates, one row an axis.
        samples: How many there are.
    """

    offsets: Int[Tensor, "r1"]
    ray: Int[Tensor, "room"]
    distance_m: Float[Tensor, "room"]
    unit: Float[Tensor, "3 room"]
    samples: int


@triton.jit
@no_type_check
def box_interval(o, d, centre, radius):
    """Distances at which rays cross the two walls of one axis, the nearer first."""
    safe = tl.where(tl.abs(d) < 1e-9, 1e-9, d)
    a, b = (centre - radius - o) / safe, (centre + radius - o) / safe
    return tl.minimum(a, b), tl.maximum(a, b)


@triton.jit
@no_type_check
def place_on_axis(unit, magnification, side):
    """Index along one axis of a cascade's grid."""
    scaled = ((unit - 0.5) * magnification + 0.5) * side
    # before the cast: far beyond the grid it would overflow
    return tl.minimum(tl.maximum(scaled, 0.0), side - 1.0).to(tl.int32)


@triton.jit
@no_type_check
def cell_at(x, y, z, side, CASCADES: tl.constexpr):
    """Flat index of the cell, in the finest cascade, that holds a unit point (``kernels/cascades.py``)."""
    magnification = tl.zeros_like(x) + 1.0
    cascade = tl.zeros_like(x).to(tl.int32) + (CASCADES - 1)
    norm = tl.maximum(tl.maximum(tl.abs(x - 0.5), tl.abs(y - 0.5)), tl.abs(z - 0.5))
    for finer in tl.static_range(1, CASCADES):
        inside = norm * (1 << finer) < 0.5
        magnification = tl.where(inside, 1.0 * (1 << finer), magnification)
        cascade = tl.where(inside, CASCADES - 1 - finer, cascade)
    i = place_on_axis(x, magnification, side)
    j = place_on_axis(y, magnification, side)
    k = place_on_axis(z, magnification, side)
    return ((cascade * side + k) * side + j) * side + i


@triton.jit(do_not_specialize=["rays", "first_ray", "seed_low", "seed_high"])
@no_type_check
def march_kernel(
    origins,
    directions,
    weights,
    occupied,
    counts,
    offsets,
    ray_out,
    distance_out,
    unit_out,
    rays,
    first_ray,
    seed_low,
    seed_high,
    room,
    steps,
    side,
    centre_x,
    centre_y,
    centre_z,
    radius,
    step,
    near,
    growth,
    UNBOUNDED: tl.constexpr,
    JITTERED: tl.constexpr,
    WEIGHTED: tl.constexpr,
    WRITE: tl.constexpr,
    DIMENSION: tl.constexpr,
    CASCADES: tl.constexpr,
    R: tl.constexpr,
    S: tl.constexpr,
):
    """Without WRITE each ray's number of samples, with it the samples; rays of no weight have none."""
    ray = tl.program_id(0) * R + tl.arange(0, R)
    on = ray < rays
    ox = tl.load(origins + 3 * ray, mask=on, other=0.0)[:, None]
    oy = tl.load(origins + 3 * ray + 1, mask=on, other=0.0)[:, None]
    oz = tl.load(origins + 3 * ray + 2, mask=on, other=0.0)[:, None]
    dx = tl.load(directions + 3 * ray, mask=on, other=0.0)[:, None]
    dy = tl.load(directions + 3 * ray + 1, mask=on, other=0.0)[:, None]
    dz = tl.load(directions + 3 * ray + 2, mask=on, other=0.0)[:, None]
    if WEIGHTED:
        on = on & (tl.load(weights + ray, mask=on, other=0.0) > 0)
    if JITTERED:
        jitter = uniform(seed_low, seed_high, ray + first_ray, DIMENSION)[:, None]
    else:
        jitter = tl.zeros([R, 1], tl.float32) + 0.5
    enter = tl.zeros([R, 1], tl.float32)
    leave = enter
    if not UNBOUNDED:
        near_x, far_x = box_interval(ox, dx, centre_x, radius)
        near_y, far_y = box_interval(oy, dy, centre_y, radius)
        near_z, far_z = box_interval(oz, dz, centre_z, radius)
        enter = tl.maximum(tl.maximum(near_x, near_y), tl.maximum(near_z, 0.0))
        leave = tl.minimum(tl.minimum(far_x, far_y), far_z)
    found = tl.zeros([R], tl.int32)
    at = found
    if WRITE:
        at = tl.load(offsets + ray, mask=ray < rays, other=0)
    for first in range(0, steps, S):
        k = (first + tl.arange(0, S))[None, :]
        here = on[:, None] & (k < steps)
        if UNBOUNDED:
            a = (k + jitter) * growth
            t = near + radius * 0.5 * (tl.exp(a) - tl.exp(-a))
        else:
            t = enter + (k + jitter) * step
            here = here & (t < leave)
        x, y, z = to_unit(
            ox + t * dx, oy + t * dy, oz + t * dz, centre_x, centre_y, centre_z, radius, UNBOUNDED
        )
        cell = cell_at(x, y, z, side, CASCADES)
        here = here & (tl.load(occupied + cell, mask=here, other=0) != 0)
        if WRITE:
            slot = at[:, None] + found[:, None] + tl.cumsum(here.to(tl.int32), 1) - 1
            tl.store(ray_out + slot, ray[:, None] + tl.zeros_like(slot), mask=here)
            tl.store(distance_out + slot, t, mask=here)
            tl.store(unit_out + slot, x, mask=here)
            tl.store(unit_out + room + slot, y, mask=here)
            tl.store(unit_out + 2 * room + slot, z, mask=here)
        found += tl.sum(here.to(tl.int32), 1)
    if not WRITE:
        tl.store(counts + ray, found, mask=ray < rays)


@dataclass(frozen=True)
class Marcher:
    """Marches rays through a scene.

    Attributes:
        occupied: Cells of the unit cube worth sampling, finest cascade first.
        scene: Space and steps.
        config: How to run.
        seed: Where in its step each ray's samples lie; None = in the middle.
    """

    occupied: Bool[Tensor, "k z y x"]
    scene: SceneArguments
    config: TritonConfig
    seed: int | None

    def waves(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        weights: Float[Tensor, "r"] | None,
        first_ray: int = 0,
    ) -> Iterator[tuple[int, MarchedRays]]:
        """Samples of consecutive rays, few enough at a time, and the number of the first of these rays.

        One number a wave comes back from the device, to size the arrays.

        Args:
            origins: World points [m], contiguous.
            directions: Unit world directions, contiguous.
            weights: Rays of weight 0 get no samples; None = all of them do.
            first_ray: Number of the first ray among all that share the seed.
        """
        rays, most = len(origins), self.config.wave_rays
        if rays <= most:
            counts = torch.empty(rays, dtype=torch.int32, device=origins.device)
            offsets = torch.zeros(rays + 1, dtype=torch.int32, device=origins.device)
            arrays = (origins, directions, origins if weights is None else weights)
            self._launch(
                arrays, weights is not None, first_ray, (counts, offsets, counts, origins, origins), False
            )
            torch.cumsum(counts, 0, dtype=torch.int32, out=offsets[1:])
            samples = int(offsets[-1])
            if samples <= self.config.wave_samples or rays == 1:
                room = max(programs(samples, self.config.room), 1) * self.config.room
                ray = torch.empty(room, dtype=torch.int32, device=origins.device)
                distance, unit = torch.empty_like(ray, dtype=torch.float32), origins.new_empty(3, room)
                if samples:
                    out = (counts, offsets, ray, distance, unit)
                    self._launch(arrays, weights is not None, first_ray, out, True)
                yield first_ray, MarchedRays(offsets, ray, distance, unit, samples)
                return
            most = rays // 2
        for first in range(0, rays, most):
            part = slice(first, first + most)
            trusted = None if weights is None else weights[part]
            yield from self.waves(origins[part], directions[part], trusted, first_ray + first)

    def _launch(
        self,
        arrays: tuple[Tensor, Tensor, Tensor],
        weighted: bool,
        first_ray: int,
        out: tuple[Tensor, Tensor, Tensor, Tensor, Tensor],
        write: bool,
    ) -> None:
        rays, scene, blocks = len(arrays[0]), self.scene, self.config.blocks
        if rays == 0:
            return
        origins, directions, weights = arrays
        counts, offsets, ray, distance, unit = out
        march_kernel[(programs(rays, blocks.rays),)](
            *(origins, directions, weights, self.occupied.view(torch.uint8)),
            *(counts, offsets, ray, distance, unit, rays, first_ray, *split_seed(self.seed or 0)),
            *(unit.shape[-1], scene.steps, self.occupied.shape[-1]),
            *(*scene.centre_m, scene.radius_m, scene.step_m, scene.near_m, scene.growth),
            UNBOUNDED=scene.unbounded,
            JITTERED=self.seed is not None,
            WEIGHTED=weighted,
            WRITE=write,
            DIMENSION=JITTER,
            CASCADES=len(self.occupied),
            R=blocks.rays,
            S=blocks.steps,
        )
