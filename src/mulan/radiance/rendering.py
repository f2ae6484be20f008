"""From rays to the field's answer along them: march, density first, colour only where light still reaches."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.composite import Composite, blend_weights, composite, transmittance
from mulan.radiance.kernels.march import march_rays
from mulan.radiance.networks import RadianceField
from mulan.radiance.space import SceneSpace


@dataclass(frozen=True)
class FieldSamples:
    """The samples that light reaches, with what the field says there.

    Attributes:
        ray_index: Ray of each sample, non-decreasing.
        distance_m: Distance along the ray.
        blend: Compositing weight.
        colour: Colour seen from the ray's origin.
        variance: Colour variance.
        marched: How many samples were marched, reached or not.
    """

    ray_index: Int[Tensor, "s"]
    distance_m: Float[Tensor, "s"]
    blend: Float[Tensor, "s"]
    colour: Float[Tensor, "s 3"]
    variance: Float[Tensor, "s"]
    marched: int

    def composite(self, rays: int) -> Composite:
        """Sums along each ray."""
        return composite(self.blend, self.ray_index, self.colour, self.variance, self.distance_m, rays)


def evaluate_rays(
    field: RadianceField,
    space: SceneSpace,
    march: MarchConfig,
    occupied: Bool[Tensor, "k z y x"],
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    jitter: Float[Tensor, "r"],
    least_opacity: Float[Tensor, "r"] | None = None,
    variance_teaches_trunk: bool = False,
) -> FieldSamples:
    """Samples along world rays; differentiable in the field's parameters and, distances held, in the rays.

    Samples thinner than their ray's ``least_opacity`` count as empty. Gradients to the variances stop at the
    variance head unless ``variance_teaches_trunk``.
    """
    with torch.no_grad():
        samples = march_rays(origins, directions, space, march, occupied, jitter)
    ray, t = samples.ray_index, samples.distance_m
    along = directions.index_select(0, ray)
    points = origins.index_select(0, ray) + t[:, None] * along
    density, hidden, features = field.geometry(space.to_unit(points))
    optical_depth = density * (samples.step_m / space.radius_m)
    thick = torch.ones_like(ray, dtype=torch.bool)
    if least_opacity is not None:
        thick = -torch.expm1(-optical_depth.detach()) >= least_opacity[ray]
        optical_depth = optical_depth.where(thick, 0.0)
    reached = transmittance(optical_depth, ray) > march.min_transmittance
    kept = (reached & thick).nonzero()[:, 0]
    if len(kept) < len(ray):
        ray, t, along = ray[kept], t[kept], along[kept]
        hidden, features = hidden.index_select(0, kept), features.index_select(0, kept)
        optical_depth = optical_depth.index_select(0, kept)
    return FieldSamples(
        ray_index=ray,
        distance_m=t,
        blend=blend_weights(optical_depth, ray),
        colour=field.colour(features, along),
        variance=field.variance(hidden, features, variance_teaches_trunk),
        marched=len(samples.ray_index),
    )
