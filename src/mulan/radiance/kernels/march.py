"""Where samples lie on rays: uniform steps through a box, growing steps through an unbounded world."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.cascades import cell_at
from mulan.radiance.space import SceneSpace

NEAR_RADII, FAR_RADII = 0.02, 64.0  # first and last distance of an unbounded ray, in scene radii


@dataclass(frozen=True)
class MarchedSamples:
    """Samples in occupied cells, packed ray by ray, near to far.

    Attributes:
        ray_index: Ray of each sample, non-decreasing.
        distance_m: Distance along the ray.
        step_m: Length of ray the sample stands for.
    """

    ray_index: Int[Tensor, "s"]
    distance_m: Float[Tensor, "s"]
    step_m: Float[Tensor, "s"]


def step_count(march: MarchConfig) -> int:
    """Steps a ray is cut into, and so the bound on its samples."""
    return min(march.steps, march.max_samples_per_ray)


def bounded_step_m(march: MarchConfig, space: SceneSpace) -> float:
    """Step length in a bounded scene: the box diagonal over the number of steps."""
    return 2 * math.sqrt(3) * space.radius_m / step_count(march)


def unbounded_distance_m(fraction: Float[Tensor, "*b"], radius_m: float) -> Float[Tensor, "*b"]:
    """Distance at a fraction in [0, 1] of an unbounded ray: ``near + radius · sinh(k · fraction)``.

    Steps are nearly equal within one scene radius and grow in proportion to distance beyond it; k puts
    fraction 1 at ``FAR_RADII``.
    """
    k = math.asinh(FAR_RADII - NEAR_RADII)
    return radius_m * (NEAR_RADII + torch.sinh(k * fraction))


def unbounded_step_m(
    distance_m: Float[Tensor, "*b"], march: MarchConfig, radius_m: float
) -> Float[Tensor, "*b"]:
    """Step length at a distance along an unbounded ray (derivative of :func:`unbounded_distance_m`)."""
    k = math.asinh(FAR_RADII - NEAR_RADII)
    return k / step_count(march) * torch.sqrt(radius_m**2 + (distance_m - NEAR_RADII * radius_m) ** 2)


def fraction_of_ray(
    distance_m: Float[Tensor, "*b"], march: MarchConfig, space: SceneSpace
) -> Float[Tensor, "*b"]:
    """Distance in units in which all ``step_count`` steps of a ray are equally long and make 1 together."""
    if space.unbounded:
        growth = math.asinh(FAR_RADII - NEAR_RADII)
        return torch.asinh(distance_m / space.radius_m - NEAR_RADII) / growth
    return distance_m / (bounded_step_m(march, space) * step_count(march))


def march_rays(
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    space: SceneSpace,
    march: MarchConfig,
    occupied: Bool[Tensor, "k z y x"],
    jitter: Float[Tensor, "r"],
) -> MarchedSamples:
    """Samples of rays that fall in occupied cells of the unit cube.

    Args:
        origins: World points [m].
        directions: Unit world directions.
        space: World to unit cube.
        march: Number of steps; no ray gets more than ``min(steps, max_samples_per_ray)`` samples.
        occupied: Cells of the unit cube worth sampling, finest cascade first.
        jitter: Where in its step each ray's samples lie, in [0, 1); 0.5 for rendering.
    """
    steps = step_count(march)
    if space.unbounded:
        edges = torch.arange(steps, dtype=origins.dtype) + jitter[:, None]
        distance = unbounded_distance_m(edges / steps, space.radius_m)
        points = origins[:, None] + distance[..., None] * directions[:, None]
        unit = space.to_unit(points.view(-1, 3)).view(*distance.shape, 3)
        inside = _lookup(unit.unbind(-1), occupied)
        ray_index, column = inside.nonzero(as_tuple=True)
        t = distance[ray_index, column]
        return MarchedSamples(ray_index, t, unbounded_step_m(t, march, space.radius_m))
    step = bounded_step_m(march, space)
    enter, leave = box_interval(origins, directions, space)
    hit = (leave > enter).nonzero()[:, 0]
    distance = enter[hit, None] + (torch.arange(steps, dtype=origins.dtype) + jitter[hit, None]) * step
    start = space.to_unit(origins[hit])
    slope = directions[hit] * (0.5 / space.radius_m)
    unit = [torch.addcmul(start[:, a, None], slope[:, a, None], distance) for a in range(3)]
    inside = _lookup(unit, occupied) & (distance < leave[hit, None])
    row, column = inside.nonzero(as_tuple=True)
    t = distance[row, column]
    return MarchedSamples(hit[row], t, torch.full_like(t, step))


def box_interval(
    origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"], space: SceneSpace
) -> tuple[Float[Tensor, "r"], Float[Tensor, "r"]]:
    """Distances at which rays enter (at least 0) and leave the box; enter >= leave for a miss."""
    centre = origins.new_tensor(space.centre_m)
    safe = torch.where(directions.abs() < 1e-9, torch.full_like(directions, 1e-9), directions)
    a = (centre - space.radius_m - origins) / safe
    b = (centre + space.radius_m - origins) / safe
    return torch.minimum(a, b).amax(-1).clamp_min(0.0), torch.maximum(a, b).amin(-1)


def _lookup(unit: tuple[Tensor, ...] | list[Tensor], occupied: Bool[Tensor, "k z y x"]) -> Tensor:
    flat = cell_at(unit, *occupied.shape[:2])
    return occupied.view(-1).index_select(0, flat.view(-1)).view(flat.shape)
