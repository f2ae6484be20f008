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
from mulan.radiance.networks import LOG_DENSITY_MAX

DENSITY_MAX = 0.999 * float(torch.tensor(LOG_DENSITY_MAX).exp())  # beyond it the density no longer learns


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
    rays,
    room,
    radius,
    step,
    near,
    growth,
    background,
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
    behind = (1 - opacity) * background
    tl.store(out_colour + 3 * ray, red + behind, mask=on)
    tl.store(out_colour + 3 * ray + 1, green + behind, mask=on)
    tl.store(out_colour + 3 * ray + 2, blue + behind, mask=on)
    tl.store(out_depth + ray, moment / tl.maximum(opacity, 1e-10), mask=on)
    tl.store(out_opacity + ray, opacity, mask=on)
    tl.store(out_variance + ray, total_variance, mask=on)


@triton.jit(do_not_specialize=["rays"])
@no_type_check
def composite_backward_kernel(
    offsets,
    distance,
    density,
    colour,
    ray_colour,
    colour_gradient,
    variance_gradient,
    to_logits,
    to_log_density,
    to_variance,
    rays,
    room,
    radius,
    step,
    near,
    growth,
    background,
    density_max,
    UNBOUNDED: tl.constexpr,
    R: tl.constexpr,
    S: tl.constexpr,
):
    """From gradients to rays' colours and variances to those to samples' logits, log-densities, variances.

    The variance's gradient stops at the blend.
    """
    ray = tl.program_id(0) * R + tl.arange(0, R)
    on = ray < rays
    start = tl.load(offsets + ray, mask=on, other=0)
    count = tl.load(offsets + ray + 1, mask=on, other=0) - start
    g_red = tl.load(colour_gradient + 3 * ray, mask=on, other=0.0)[:, None]
    g_green = tl.load(colour_gradient + 3 * ray + 1, mask=on, other=0.0)[:, None]
    g_blue = tl.load(colour_gradient + 3 * ray + 2, mask=on, other=0.0)[:, None]
    g_variance = tl.load(variance_gradient + ray, mask=on, other=0.0)[:, None]
    # a ray's blends times what they are worth add up to its colour's worth over the background's
    later = tl.sum(g_red * (tl.load(ray_colour + 3 * ray, mask=on, other=0.0)[:, None] - background), 1)
    later += tl.sum(
        g_green * (tl.load(ray_colour + 3 * ray + 1, mask=on, other=0.0)[:, None] - background), 1
    )
    later += tl.sum(g_blue * (tl.load(ray_colour + 3 * ray + 2, mask=on, other=0.0)[:, None] - background), 1)
    before = tl.zeros([R], tl.float32)
    for first in range(0, tl.max(count, 0), S):
        k = first + tl.arange(0, S)[None, :]
        at, here = start[:, None] + k, k < count[:, None]
        t = tl.load(distance + at, mask=here, other=0.0)
        sigma = tl.load(density + at, mask=here, other=0.0)
        depth = sigma * step_in_radii(t, radius, step, near, growth, UNBOUNDED)
        reach, left, before = reach_of(depth, before)
        blend = reach * alpha_of(depth)
        red = tl.load(colour + at, mask=here, other=0.0)
        green = tl.load(colour + room + at, mask=here, other=0.0)
        blue = tl.load(colour + 2 * room + at, mask=here, other=0.0)
        worth = g_red * (red - background) + g_green * (green - background) + g_blue * (blue - background)
        gained = worth * blend
        # every later sample of the ray loses its own blend
        to_depth = worth * left - (later[:, None] - tl.cumsum(gained, 1))
        later -= tl.sum(gained, 1)
        tl.store(to_log_density + at, tl.where(sigma < density_max, to_depth * depth, 0.0), mask=here)
        tl.store(to_logits + at, g_red * blend * red * (1 - red), mask=here)
        tl.store(to_logits + room + at, g_green * blend * green * (1 - green), mask=here)
        tl.store(to_logits + 2 * room + at, g_blue * blend * blue * (1 - blue), mask=here)
        tl.store(to_variance + at, g_variance * blend * blend, mask=here)


@dataclass(frozen=True)
class RayAnswers:
    """What rays collect: colour over the background, mean distance, opacity, colour variance."""

    colour: Float[Tensor, "r 3"]
    depth_m: Float[Tensor, "r"]
    opacity: Float[Tensor, "r"]
    variance: Float[Tensor, "r"]


@dataclass(frozen=True)
class SampleGradients:
    """Gradient to each sample's colour logits, log-density and colour variance."""

    logits: Float[Tensor, "3 room"]
    log_density: Float[Tensor, "room"]
    variance: Float[Tensor, "room"]


class GpuCompositor:
    """Sums along rays and their gradients."""

    def __init__(self, scene: SceneArguments, config: TritonConfig) -> None:
        self._scene, self._blocks = scene, config.blocks

    def composite(
        self,
        offsets: Int[Tensor, "r1"],
        distance_m: Float[Tensor, "room"],
        density: Float[Tensor, "room"],
        colour: Float[Tensor, "3 room"],
        variance: Float[Tensor, "room"],
        blend: Float[Tensor, "room"] | None = None,
    ) -> RayAnswers:
        """What each ray collects; densities are per scene radius. Fills ``blend`` where it is given."""
        rays = len(offsets) - 1
        scalars = torch.empty(3, rays, device=offsets.device).unbind(0)
        answers = RayAnswers(torch.empty(rays, 3, device=offsets.device), *scalars)
        samples = (offsets, distance_m, density, colour, variance)
        out = (answers.colour, answers.depth_m, answers.opacity, answers.variance)
        if rays:
            composite_kernel[(programs(rays, self._blocks.rays),)](
                *samples,
                *out,
                *(density if blend is None else blend, rays, colour.shape[1], *self._lengths),
                self._scene.background,
                UNBOUNDED=self._scene.unbounded,
                WRITE_BLEND=blend is not None,
                R=self._blocks.rays,
                S=self._blocks.steps,
            )
        return answers

    def backward(
        self,
        offsets: Int[Tensor, "r1"],
        distance_m: Float[Tensor, "room"],
        density: Float[Tensor, "room"],
        colour: Float[Tensor, "3 room"],
        answers: RayAnswers,
        colour_gradient: Float[Tensor, "r 3"],
        variance_gradient: Float[Tensor, "r"],
    ) -> SampleGradients:
        """Gradients to the samples from those to the rays' colours and variances."""
        rays, room = len(offsets) - 1, colour.shape[1]
        out = SampleGradients(torch.empty_like(colour), torch.empty_like(density), torch.empty_like(density))
        composite_backward_kernel[(programs(rays, self._blocks.rays),)](
            *(offsets, distance_m, density, colour, answers.colour, colour_gradient, variance_gradient),
            *(out.logits, out.log_density, out.variance, rays, room, *self._lengths),
            *(self._scene.background, DENSITY_MAX),
            UNBOUNDED=self._scene.unbounded,
            R=self._blocks.rays,
            S=self._blocks.steps,
        )
        return out

    @property
    def _lengths(self) -> tuple[float, float, float, float]:
        s = self._scene
        return s.radius_m, s.step_m, s.near_m, s.growth
