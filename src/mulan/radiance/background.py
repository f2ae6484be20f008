"""Backgrounds while learning: the scene's own white or black, or a random colour every ray."""

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.split_step import BatchPart


def random_background(
    colours: Float[Tensor, "r 3"],
    opacity: Float[Tensor, "r"] | None,
    background: Float[Tensor, "3"],
    generator: torch.Generator,
    part: BatchPart | None = None,
) -> tuple[Float[Tensor, "r 3"], Float[Tensor, "r 3"]]:
    """A random colour for each ray, and the targets moved from the scene's background onto it.

    Args:
        colours: Targets over the scene's background.
        opacity: Coverage by the object of each ray's pixel.
        background: The scene's own.
        generator: Source of the colours.
        part: Which rays of a joint batch these are; all of it if not given.

    Raises:
        ValueError: The batch has no opacities.
    """
    if opacity is None:
        raise ValueError("random backgrounds need the opacity of every pixel, which only cut-out images have")
    part = part or BatchPart.whole(len(colours))
    drawn = part.uniform(generator, 3)
    return drawn, colours + (1 - opacity)[:, None] * (drawn - background)
