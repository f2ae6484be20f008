"""Distortion of the blend along rays: large where a ray's weight is scattered by fog and floaters."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.kernels.composite import exclusive_sum


def distortion(
    blend: Float[Tensor, "s"],
    ray_index: Int[Tensor, "s"],
    fraction: Float[Tensor, "s"],
    step: float,
    rays: int,
) -> Float[Tensor, "r"]:
    """Distortion of each ray: ``sum_ij w_i w_j |s_i - s_j| + step/3 sum_i w_i²`` (mip-NeRF 360, eq. 15).

    In one pass, as samples are in order: each counts its distance to the weight before it twice (DVGO v2,
    Sun et al. 2022, eq. 4). Differentiable in the blend; sample places count as given.

    Args:
        blend: Compositing weight w of each sample.
        ray_index: Non-decreasing ray of each sample.
        fraction: Place s of each sample along its ray, non-decreasing on a ray.
        step: Length of ray that a sample stands for, in the same unit.
        rays: How many rays there are.
    """
    before = exclusive_sum(blend, ray_index)
    moment_before = exclusive_sum(blend * fraction, ray_index)
    apart = 2 * blend * (fraction * before - moment_before)
    within = blend.square() * (step / 3)
    zero = torch.zeros(rays, dtype=blend.dtype)
    return zero.index_add(0, ray_index, (apart + within).to(blend.dtype))
