"""What belongs to a ray as a whole: harmonics of its direction, gradients gathered from its samples."""

from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.gpu.network_kernels import HARMONICS
from mulan.radiance.gpu.reach_kernels import ReachedSamples
from mulan.radiance.gpu.space_kernels import SceneArguments, to_unit_backward
from mulan.radiance.kernels.spherical_harmonics import spherical_harmonics
from mulan.radiance.ray_gradients import RayGradients


@triton.jit(do_not_specialize=["rays"])
@no_type_check
def gather_kernel(
    offsets,
    distance,
    origins,
    directions,
    point_gradient,
    harmonics_gradient,
    to_origin,
    to_direction,
    to_harmonics,
    rays,
    room,
    centre_x,
    centre_y,
    centre_z,
    radius,
    UNBOUNDED: tl.constexpr,
    HARMONICS: tl.constexpr,
    R: tl.constexpr,
    S: tl.constexpr,
):
    """Sums along each ray of the gradients to its origin, direction and harmonics, at given distances."""
    ray = tl.program_id(0) * R + tl.arange(0, R)
    on = ray < rays
    start = tl.load(offsets + ray, mask=on, other=0)
    count = tl.load(offsets + ray + 1, mask=on, other=0) - start
    ox = tl.load(origins + 3 * ray, mask=on, other=0.0)[:, None]
    oy = tl.load(origins + 3 * ray + 1, mask=on, other=0.0)[:, None]
    oz = tl.load(origins + 3 * ray + 2, mask=on, other=0.0)[:, None]
    dx = tl.load(directions + 3 * ray, mask=on, other=0.0)[:, None]
    dy = tl.load(directions + 3 * ray + 1, mask=on, other=0.0)[:, None]
    dz = tl.load(directions + 3 * ray + 2, mask=on, other=0.0)[:, None]
    zero = tl.zeros([R], tl.float32)
    gox, goy, goz, gdx, gdy, gdz = zero, zero, zero, zero, zero, zero
    for first in range(0, tl.max(count, 0), S):
        k = first + tl.arange(0, S)[None, :]
        at, here = start[:, None] + k, k < count[:, None]
        t = tl.load(distance + at, mask=here, other=0.0)
        gx = tl.load(point_gradient + at, mask=here, other=0.0)
        gy = tl.load(point_gradient + room + at, mask=here, other=0.0)
        gz = tl.load(point_gradient + 2 * room + at, mask=here, other=0.0)
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        gx, gy, gz = to_unit_backward(x, y, z, gx, gy, gz, centre_x, centre_y, centre_z, radius, UNBOUNDED)
        gox += tl.sum(gx, 1)
        goy += tl.sum(gy, 1)
        goz += tl.sum(gz, 1)
        gdx += tl.sum(t * gx, 1)
        gdy += tl.sum(t * gy, 1)
        gdz += tl.sum(t * gz, 1)
    tl.store(to_origin + 3 * ray, gox, mask=on)
    tl.store(to_origin + 3 * ray + 1, goy, mask=on)
    tl.store(to_origin + 3 * ray + 2, goz, mask=on)
    tl.store(to_direction + 3 * ray, gdx, mask=on)
    tl.store(to_direction + 3 * ray + 1, gdy, mask=on)
    tl.store(to_direction + 3 * ray + 2, gdz, mask=on)
    for band in range(HARMONICS):
        total = tl.zeros([R], tl.float32)
        for first in range(0, tl.max(count, 0), S):
            k = first + tl.arange(0, S)[None, :]
            at, here = start[:, None] + k, k < count[:, None]
            total += tl.sum(tl.load(harmonics_gradient + band * room + at, mask=here, other=0.0), 1)
        tl.store(to_harmonics + HARMONICS * ray + band, total, mask=on)


def direction_harmonics(directions: Float[Tensor, "r 3"], degree: int) -> Float[Tensor, "r 16"]:
    """Harmonics of each ray's direction, padded with zeros."""
    out = directions.new_zeros(len(directions), HARMONICS.value)
    out[:, : degree**2] = spherical_harmonics(directions, degree)
    return out


def gather_ray_gradients(
    reached: ReachedSamples,
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    point_gradient: Float[Tensor, "3 room"],
    harmonics_gradient: Float[Tensor, "bands room"],
    degree: int,
    scene: SceneArguments,
    config: TritonConfig,
) -> RayGradients:
    """Gradients to the rays from those to their samples' unit points and harmonics."""
    rays, blocks = len(origins), config.blocks
    out = RayGradients(torch.empty_like(origins), torch.empty_like(directions))
    to_harmonics = origins.new_empty(rays, HARMONICS.value)
    if rays == 0:
        return out
    gather_kernel[(programs(rays, blocks.rays),)](
        *(reached.offsets, reached.distance_m, origins, directions, point_gradient, harmonics_gradient),
        *(out.origins, out.directions, to_harmonics, rays, point_gradient.shape[1]),
        *(*scene.centre_m, scene.radius_m),
        UNBOUNDED=scene.unbounded,
        HARMONICS=HARMONICS.value,
        R=blocks.rays,
        S=blocks.steps,
    )
    if degree > 1:  # the first band is constant
        with torch.enable_grad():
            turned = directions.detach().requires_grad_()
            bands = spherical_harmonics(turned, degree)
            (to_direction,) = torch.autograd.grad(bands, turned, to_harmonics[:, : degree**2])
        out.directions.add_(to_direction)
    return out
