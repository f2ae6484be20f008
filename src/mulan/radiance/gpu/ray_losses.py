"""What rays cost while learning, and the gradients of that to what they collect.

Rays are few beside their samples, so this is plain torch and takes any :class:`ColourLoss`.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.gpu.composite_kernels import RayAnswers
from mulan.radiance.loss import RENDERED_VARIANCE_FLOOR, gaussian_likelihood, opacity_entropy
from mulan.radiance.optimiser_config import OptimiserConfig


@dataclass(frozen=True)
class RayLosses:
    """Losses of rays and the gradients of their sum.

    Attributes:
        loss: Of each ray, already weighted by its share of the batch's weight.
        squared_error: Mean over channels, unweighted; 0 for a ray of no weight.
        colour_gradient, opacity_gradient, variance_gradient: To what each ray collects.
        distortion_weight: Of each ray's distortion, which is not in the loss yet; None = it costs nothing.
        variance_teaches: Whether the variance's gradient goes beyond its own head.
    """

    loss: Float[Tensor, "r"]
    squared_error: Float[Tensor, "r"]
    colour_gradient: Float[Tensor, "r 3"]
    opacity_gradient: Float[Tensor, "r"]
    variance_gradient: Float[Tensor, "r"]
    distortion_weight: Float[Tensor, "r"] | None
    variance_teaches: bool

    @staticmethod
    def given(colour_gradient: Float[Tensor, "r 3"]) -> "RayLosses":
        """A gradient to the colours that comes from elsewhere."""
        zero = torch.zeros_like(colour_gradient[:, 0])
        return RayLosses(zero, zero, colour_gradient, zero, zero, None, False)


def ray_losses(
    answers: RayAnswers,
    target: Float[Tensor, "r 3"],
    weights: Float[Tensor, "r"],
    total_weight: Float[Tensor, ""],
    config: OptimiserConfig,
) -> RayLosses:
    """Losses of rays by the options of ``config``; a ray's share is its weight over the batch's."""
    with torch.enable_grad():
        collected = [x.detach().requires_grad_() for x in (answers.colour, answers.opacity, answers.variance)]
        colour, opacity, variance = collected
        trusted = weights > 0
        share = torch.where(trusted, weights / total_weight.clamp_min(1e-12), 0.0)
        # a ray of no weight may have any colour, even NaN
        error = torch.where(trusted[:, None], colour - target, 0.0)
        squared, v = error.square().mean(-1), variance + RENDERED_VARIANCE_FLOOR
        cost = config.loss(error, v)
        if config.entropy_weight > 0:
            cost = cost + config.entropy_weight * opacity_entropy(opacity)
        loss = share * cost
        objective = loss
        if not config.loss.teaches_variance:
            # the error counts as given: this likelihood trains the head only
            objective = loss + share * gaussian_likelihood(squared.detach(), v)
        to_colour, to_opacity, to_variance = torch.autograd.grad(
            objective.sum(), collected, allow_unused=True, materialize_grads=True
        )
    distortion = share * config.distortion_weight if config.distortion_weight > 0 else None
    return RayLosses(
        *(loss.detach(), squared.detach(), to_colour, to_opacity, to_variance),
        *(distortion, config.loss.teaches_variance),
    )
