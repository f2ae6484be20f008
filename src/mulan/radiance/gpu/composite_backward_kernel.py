"""From gradients to what rays collect back to their samples; programs walk few rays, up to three times."""

import math
from dataclasses import dataclass
from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.gpu.composite_kernels import alpha_of, reach_of
from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.gpu.ray_losses import RayLosses
from mulan.radiance.gpu.space_kernels import SceneArguments, step_in_radii
from mulan.radiance.networks import LOG_DENSITY_MAX

DENSITY_MAX = 0.999 * math.exp(LOG_DENSITY_MAX)  # beyond it the density no longer learns


@dataclass(frozen=True)
class SampleGradients:
    """Gradient to each sample's colour logits, log-density and colour variance."""

    logits: Float[Tensor, "3 room"]
    log_density: Float[Tensor, "room"]
    variance: Float[Tensor, "room"]


@triton.jit
@no_type_check
def fraction_of_ray(t, radius, step, near, growth, steps, UNBOUNDED: tl.constexpr):
    """Distance in units in which all steps of a ray are equally long and make 1 together."""
    if UNBOUNDED:
        x = (t - near) / radius
        return tl.log(x + tl.sqrt(x * x + 1)) / (growth * steps)
    else:
        return t / (step * steps)


@triton.jit
@no_type_check
def scatter_of(blend, place, seen, seen_moment, all_blend, all_moment, step):
    """Half the slope of the distortion over each blend, the samples' part of it, and the sums so far."""
    moment = blend * place
    before = seen[:, None] + tl.cumsum(blend, 1) - blend
    moment_before = seen_moment[:, None] + tl.cumsum(moment, 1) - moment
    in_front = place * before - moment_before
    behind = all_moment[:, None] - moment_before - moment - place * (all_blend[:, None] - before - blend)
    within = blend * (step / 3)
    cost = tl.sum(blend * (2 * in_front + within), 1)
    return in_front + behind + within, cost, seen + tl.sum(blend, 1), seen_moment + tl.sum(moment, 1)


@triton.jit(do_not_specialize=["rays"])
@no_type_check
def composite_backward_kernel(
    offsets,
    distance,
    density,
    colour,
    variance,
    backgrounds,
    colour_gradient,
    opacity_gradient,
    variance_gradient,
    distortion_weight,
    distortion_out,
    to_logits,
    to_log_density,
    to_variance,
    background_stride,
    rays,
    room,
    radius,
    step,
    near,
    growth,
    steps,
    density_max,
    UNBOUNDED: tl.constexpr,
    TEACH: tl.constexpr,
    DISTORT: tl.constexpr,
    R: tl.constexpr,
    S: tl.constexpr,
):
    """Gradients to samples; the variance's stops at the blend unless TEACH, DISTORT adds the distortion's."""
    ray = tl.program_id(0) * R + tl.arange(0, R)
    on = ray < rays
    start = tl.load(offsets + ray, mask=on, other=0)
    count = tl.load(offsets + ray + 1, mask=on, other=0) - start
    longest = tl.max(count, 0)
    g_red = tl.load(colour_gradient + 3 * ray, mask=on, other=0.0)[:, None]
    g_green = tl.load(colour_gradient + 3 * ray + 1, mask=on, other=0.0)[:, None]
    g_blue = tl.load(colour_gradient + 3 * ray + 2, mask=on, other=0.0)[:, None]
    g_opacity = tl.load(opacity_gradient + ray, mask=on, other=0.0)[:, None]
    g_variance = tl.load(variance_gradient + ray, mask=on, other=0.0)[:, None]
    behind = backgrounds + background_stride * ray
    # what a sample hides of the background, it loses
    g_opacity -= g_red * tl.load(behind, mask=on, other=0.0)[:, None]
    g_opacity -= g_green * tl.load(behind + 1, mask=on, other=0.0)[:, None]
    g_opacity -= g_blue * tl.load(behind + 2, mask=on, other=0.0)[:, None]
    zero = tl.zeros([R], tl.float32)
    all_blend, all_moment, cost = zero, zero, zero
    if DISTORT:
        weight = tl.load(distortion_weight + ray, mask=on, other=0.0)
        before = zero
        for first in range(0, longest, S):
            k = first + tl.arange(0, S)[None, :]
            at, here = start[:, None] + k, k < count[:, None]
            t = tl.load(distance + at, mask=here, other=0.0)
            depth = tl.load(density + at, mask=here, other=0.0)
            depth *= step_in_radii(t, radius, step, near, growth, UNBOUNDED)
            reach, _, before = reach_of(depth, before)
            blend = reach * alpha_of(depth)
            all_blend += tl.sum(blend, 1)
            place = fraction_of_ray(t, radius, step, near, growth, steps, UNBOUNDED)
            all_moment += tl.sum(blend * place, 1)
    # first what all samples are worth together, then what is left behind each
    later = zero
    for final in tl.static_range(2):
        before, seen, seen_moment = zero, zero, zero
        for first in range(0, longest, S):
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
            worth = g_opacity + g_red * red + g_green * green + g_blue * blue
            if TEACH:
                worth += 2 * g_variance * blend * tl.load(variance + at, mask=here, other=0.0)
            if DISTORT:
                place = fraction_of_ray(t, radius, step, near, growth, steps, UNBOUNDED)
                scatter, own, seen, seen_moment = scatter_of(
                    blend, place, seen, seen_moment, all_blend, all_moment, 1.0 / steps
                )
                worth += 2 * weight[:, None] * scatter
                if final == 0:
                    cost += own
            gained = worth * blend
            if final == 0:
                later += tl.sum(gained, 1)
            else:
                # every later sample of the ray loses its own blend
                to_depth = worth * left - (later[:, None] - tl.cumsum(gained, 1))
                later -= tl.sum(gained, 1)
                tl.store(to_log_density + at, tl.where(sigma < density_max, to_depth * depth, 0.0), mask=here)
                tl.store(to_logits + at, g_red * blend * red * (1 - red), mask=here)
                tl.store(to_logits + room + at, g_green * blend * green * (1 - green), mask=here)
                tl.store(to_logits + 2 * room + at, g_blue * blend * blue * (1 - blue), mask=here)
                tl.store(to_variance + at, g_variance * blend * blend, mask=here)
    if DISTORT:
        tl.store(distortion_out + ray, weight * cost, mask=on)


def composite_backward(
    offsets: Int[Tensor, "r1"],
    distance_m: Float[Tensor, "room"],
    density: Float[Tensor, "room"],
    colour: Float[Tensor, "3 room"],
    variance: Float[Tensor, "room"],
    background: Float[Tensor, "*r 3"],
    losses: RayLosses,
    scene: SceneArguments,
    config: TritonConfig,
) -> SampleGradients:
    """Gradients to the samples; adds the rays' distortion to their losses, where it has weight."""
    rays, room, blocks = len(offsets) - 1, colour.shape[1], config.blocks
    out = SampleGradients(*(torch.empty_like(x) for x in (colour, density, density)))
    weight = losses.distortion_weight
    distortion = torch.empty_like(losses.loss)
    if rays == 0:
        return out
    composite_backward_kernel[(programs(rays, blocks.rays),)](
        *(offsets, distance_m, density, colour, variance, background),
        *(losses.colour_gradient, losses.opacity_gradient, losses.variance_gradient),
        *(distortion if weight is None else weight, distortion, out.logits, out.log_density, out.variance),
        *(3 if background.ndim > 1 else 0, rays, room, scene.radius_m, scene.step_m, scene.near_m),
        *(scene.growth, scene.steps, DENSITY_MAX),
        UNBOUNDED=scene.unbounded,
        TEACH=losses.variance_teaches,
        DISTORT=weight is not None,
        R=blocks.rays,
        S=blocks.steps,
    )
    if weight is not None:
        losses.loss.add_(distortion)
    return out
