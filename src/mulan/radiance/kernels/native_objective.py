"""What a step of the native engine learns from: the batch and the losses, as the library reads them."""

import torch
from torch import Tensor

from mulan.radiance.background import random_background
from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_buffers import address
from mulan.radiance.kernels.native_structures import NativeObjective, NativeScene
from mulan.radiance.loss import ColourLoss, GaussianLikelihoodLoss, HuberLoss, SquaredLoss
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.split_step import BatchPart


def native_objective(
    batch: RayBatch,
    config: OptimiserConfig,
    scene: NativeScene,
    generator: torch.Generator,
    part: BatchPart | None = None,
) -> tuple[NativeObjective, tuple[Tensor, ...]]:
    """Objective of a step on a batch (or a part of a joint one), and the arrays that must outlive it.

    Raises:
        ValueError: The library does not know the loss, or random backgrounds lack opacities.
    """
    colours, weights = batch.colours, batch.weights.contiguous()
    backgrounds = None
    if config.random_background:
        own = torch.tensor(list(scene.background))
        # one background a pixel, whatever the number of its rays
        each = batch.rays_a_pixel
        opacity = None if batch.opacity is None else batch.opacity[::each]
        pixels = None if part is None else part.in_pixels(each)
        drawn = random_background(colours[::each], opacity, own, generator, pixels)
        backgrounds, colours = (x.repeat_interleave(each, 0) for x in drawn)
    colours = colours.contiguous()
    rays = len(weights)
    objective = NativeObjective(
        colours=address(colours, (rays, 3)),
        weights=address(weights, (rays,)),
        backgrounds=None if backgrounds is None else address(backgrounds, (rays, 3)),
        huber_delta=huber_delta(config.loss),
        variance_weight=1.0,
        likelihood=config.loss.teaches_variance,
        distortion_weight=config.distortion_weight,
        entropy_weight=config.entropy_weight,
        rays_a_pixel=batch.rays_a_pixel,
    )
    return objective, (colours, weights) if backgrounds is None else (colours, weights, backgrounds)


def huber_delta(loss: ColourLoss) -> float:
    """Corner of Huber's loss, 0 for the squared error and for the likelihood.

    Raises:
        ValueError: The loss is another one.
    """
    match loss:
        case HuberLoss(delta):
            return delta
        case SquaredLoss() | GaussianLikelihoodLoss():
            return 0.0
    raise ValueError(f"the native engine does not know {loss}")
