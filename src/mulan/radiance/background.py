"""Backgrounds while learning: the scene's own white or black, or a random colour every ray."""

import torch
from jaxtyping import Float
from torch import Tensor


def random_background(
    colours: Float[Tensor, "r 3"],
    opacity: Float[Tensor, "r"] | None,
    background: Float[Tensor, "3"],
    generator: torch.Generator,
) -> tuple[Float[Tensor, "r 3"], Float[Tensor, "r 3"]]:
    """A random colour for each ray, and the targets moved from the scene's background onto it.

    Args:
        colours: Targets over the scene's background.
        opacity: Coverage by the object of each ray's pixel.
        background: The scene's own.
        generator: Source of the colours.

    Raises:
        ValueError: The batch has no opacities.
    """
    if opacity is None:
        raise ValueError("random backgrounds need the opacity of every pixel, which only cut-out images have")
    drawn = torch.rand(colours.shape, generator=generator)
    return drawn, colours + (1 - opacity)[:, None] * (drawn - background)
