"""Volume rendering along rays (``kernels/composite.py`` is its reference): a program walks along a few rays.

``blend_k = T_k (1 - exp(-depth_k))``, ``T_k = exp(-sum of earlier depths)`` (NeRF, eq. 3).
"""

from dataclasses import dataclass
from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.gpu.space_kernels import SceneArguments, step_in_radii


@triton.jit
@no_type_check
def alpha_of(depth):
    """``1 - exp(-depth)``, exact to rounding for thin samples too."""
    series = depth * (1 - depth * (0.5 - depth * (1.0 / 6 - depth * (1.0 / 24))))
    return tl.where(depth < 0.02, series, 1 - tl.exp(-depth))


@triton.jit
@no_type_check
def reach_of(depth, before):
    """Light that reaches and light that leaves each sample of a row, and the depth behind the last."""
    # what lies behind a depth of 30 is dark, and a larger number would cost digits
    depth = tl.minimum(depth, 30.0)
    behind = before[:, None] + tl.cumsum(depth, 1)
    return tl.exp(depth - behind), tl.exp(-behind), before + tl.sum(depth, 1)


@triton.jit(do_not_specialize=["rays"])
@no_type_check
def composite_kernel(
    offsets,
    distance,
    density,
    colour,
    variance,
    out_colour,
    out_depth,
    out_opacity,
    out_variance,
    blend_out,
    backgrounds,
    background_stride,
    rays,
    room,
    radius,
    step,
    near,
    growth,
    UNBOUNDED: tl.constexpr,
    WRITE_BLEND: tl.constexpr,
    R: tl.constexpr,
    S: tl.constexpr,
):
    """Colour over the background, mean distance, opacity and colour variance of each ray."""
    ray = tl.program_id(0) * R + tl.arange(0, R)
    on = ray < rays
    start = tl.load(offsets + ray, mask=on, other=0)
    count = tl.load(offsets + ray + 1, mask=on, other=0) - start
    before = tl.zeros([R], tl.float32)
    red, green, blue, opacity, moment, total_variance = before, before, before, before, before, before
    for first in range(0, tl.max(count, 0), S):
        k = first + tl.arange(0, S)[None, :]
        at, here = start[:, None] + k, k < count[:, None]
        t = tl.load(distance + at, mask=here, other=0.0)
        depth = tl.load(density + at, mask=here, other=0.0)
        depth *= step_in_radii(t, radius, step, near, growth, UNBOUNDED)
        reach, _, before = reach_of(depth, before)
        blend = reach * alpha_of(depth)
        red += tl.sum(blend * tl.load(colour + at, mask=here, other=0.0), 1)
        green += tl.sum(blend * tl.load(colour + room + at, mask=here, other=0.0), 1)
        blue += tl.sum(blend * tl.load(colour + 2 * room + at, mask=here, other=0.0), 1)
        opacity += tl.sum(blend, 1)
        moment += tl.sum(blend * t, 1)
        total_variance += tl.sum(blend * blend * tl.load(variance + at, mask=here, other=0.0), 1)
        if WRITE_BLEND:
            tl.store(blend_out + at, blend, mask=here)
    behind = backgrounds + background_stride * ray
    clear = 1 - opacity
    tl.store(out_colour + 3 * ray, red + clear * tl.load(behind, mask=on, other=0.0), mask=on)
    tl.store(out_colour + 3 * ray + 1, green + clear * tl.load(behind + 1, mask=on, other=0.0), mask=on)
    tl.store(out_colour + 3 * ray + 2, blue + clear * tl.load(behind + 2, mask=on, other=0.0), mask=on)
    tl.store(out_depth + ray, moment / tl.maximum(opacity, 1e-10), mask=on)
    tl.store(out_opacity + ray, opacity, mask=on)
    tl.store(out_variance + ray, total_variance, mask=on)


@dataclass(frozen=True)
class RayAnswers:
    """What rays collect: colour over the background, mean distance, opacity, colour variance."""

    colour: Float[Tensor, "r 3"]
    depth_m: Float[Tensor, "r"]
    opacity: Float[Tensor, "r"]
    variance: Float[Tensor, "r"]


class GpuCompositor:
    """Sums along rays."""

    def __init__(self, scene: SceneArguments, config: TritonConfig) -> None:
        self._scene, self._blocks = scene, config.blocks

    def composite(
        self,
        offsets: Int[Tensor, "r1"],
        distance_m: Float[Tensor, "room"],
        density: Float[Tensor, "room"],
        colour: Float[Tensor, "3 room"],
        variance: Float[Tensor, "room"],
        background: Float[Tensor, "*r 3"],
        blend: Float[Tensor, "room"] | None = None,
    ) -> RayAnswers:
        """What each ray collects; densities are per scene radius. Fills ``blend`` where it is given.

        The background is one colour for all rays or one for each.
        """
        rays = len(offsets) - 1
        scalars = torch.empty(3, rays, device=offsets.device).unbind(0)
        answers = RayAnswers(torch.empty(rays, 3, device=offsets.device), *scalars)
        samples = (offsets, distance_m, density, colour, variance)
        out = (answers.colour, answers.depth_m, answers.opacity, answers.variance)
        scene = self._scene
        if rays:
            composite_kernel[(programs(rays, self._blocks.rays),)](
                *samples,
                *out,
                *(density if blend is None else blend, background, 3 if background.ndim > 1 else 0),
                *(rays, colour.shape[1], scene.radius_m, scene.step_m, scene.near_m, scene.growth),
                UNBOUNDED=scene.unbounded,
                WRITE_BLEND=blend is not None,
                R=self._blocks.rays,
                S=self._blocks.steps,
            )
        return answers
