"""Where rays meet the surface of a field: half of the light stopped, most of it at one distance."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.engine import RadianceEngine

_RAYS_AT_ONCE = 16384
_SURFACE_DEPTH = 0.05  # what lies within this share of the distance counts as the same surface


@dataclass(frozen=True)
class SurfaceHits:
    """One entry a ray; meaningless where ``opacity`` is small.

    Attributes:
        distance_m: Median distance of what the ray sees (half of it nearer).
        opacity: Share of light stopped.
        sharpness: Share of what was stopped that lies within 5 % of the median distance; low at edges, where
            a ray sees two surfaces.
        colour: What stopped it, without the background.
        variance: Predicted variance of that colour.
        hidden: Share of light stopped before the distance asked about.
    """

    distance_m: Float[Tensor, "r"]
    opacity: Float[Tensor, "r"]
    sharpness: Float[Tensor, "r"]
    colour: Float[Tensor, "r 3"]
    variance: Float[Tensor, "r"]
    hidden: Float[Tensor, "r"]


def surface_hits(
    engine: RadianceEngine,
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    before_m: Float[Tensor, "r"] | None = None,
) -> SurfaceHits:
    """Follow rays to the surface, some thousands at a time so that memory stays bounded.

    Args:
        engine: The field.
        origins: World points [m].
        directions: Unit world directions.
        before_m: Distances that :attr:`SurfaceHits.hidden` is asked about; zeros if not given.
    """
    if before_m is None:
        before_m = torch.zeros(len(origins))
    pieces = zip(*(each.split(_RAYS_AT_ONCE) for each in (origins, directions, before_m)), strict=True)
    parts = [_hits(engine, *piece) for piece in pieces]
    names = ("distance_m", "opacity", "sharpness", "colour", "variance", "hidden")
    return SurfaceHits(*(torch.cat([getattr(part, name) for part in parts]) for name in names))


def _hits(
    engine: RadianceEngine,
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    before_m: Float[Tensor, "r"],
) -> SurfaceHits:
    samples = engine.sample(origins, directions)
    rays, ray = len(origins), samples.ray_index.long()

    def total(value: Tensor) -> Tensor:
        return torch.zeros(rays, *value.shape[1:], dtype=value.dtype).index_add(0, ray, value)

    blend = samples.blend
    opacity = total(blend)
    stopped = opacity.clamp_min(1e-6)
    # the running sum within a ray, in double since it runs over all rays
    running = blend.double().cumsum(0)
    before_ray = torch.cat([running.new_zeros(1), total(blend.double()).cumsum(0)[:-1]])
    past_half = running - before_ray[ray] >= 0.5 * opacity.double()[ray] * (1 - 1e-6)
    beyond = torch.full((rays,), torch.inf).scatter_reduce(
        0, ray[past_half], samples.distance_m[past_half], "amin"
    )
    distance_m = beyond.where(beyond.isfinite(), 0.0)
    near = (samples.distance_m - distance_m[ray]).abs() <= _SURFACE_DEPTH * distance_m[ray]
    return SurfaceHits(
        distance_m=distance_m,
        opacity=opacity,
        sharpness=total(blend * near) / stopped,
        colour=(total(blend[:, None] * samples.colour) / stopped[:, None]).clamp(0, 1),
        variance=total(blend.square() * samples.variance) / stopped.square(),
        hidden=total(blend * (samples.distance_m < before_m[ray])),
    )
