"""Which pixels of the photographs poses are judged by: mostly those where a shifted picture would differ."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from mulan.reconstruction.posed_pixels import PosedPixels

_UNIFORM_SHARE = 1 / 3  # of the draws; no pixel weighs more than three times what it would


@dataclass(frozen=True)
class PixelDraw:
    """Pixels to compare at, the same number in each image, and the axis in colour space to compare along.

    Attributes:
        image: Images, by their number in the set.
        pixel: Pixels, numbered through the whole set.
        axis: Unit vectors; one a pixel costs one backward pass and is unbiased over pixels.
        weight: Independent residuals each pixel stands for; unbiased for the sum over all pixels.
    """

    image: Int[NDArray, "n"]
    pixel: Int[Tensor, "n r"]
    axis: Float[Tensor, "n*r 3"]
    weight: Float[NDArray, "n r"]


class ComparedPixels:
    """Photographs with the chance of each pixel to be drawn: a third alike for all, the rest by its slope.

    Attributes:
        data: The photographs.
    """

    def __init__(self, data: PosedPixels) -> None:
        """Weigh the pixels of ``data``."""
        self.data = data
        self._chance = [_chances(image.colour_fraction) for image in data.images]
        self._cumulative = [np.cumsum(chance) for chance in self._chance]

    def area_px(self, residuals: float) -> float:
        """Area of neighbouring pixels that agree, if a picture has so many independent residuals."""
        return float(np.mean([len(chance) for chance in self._chance])) / residuals

    def draw(
        self, image: Int[NDArray, "n"], rays: int, pixels_a_residual: float, generator: torch.Generator
    ) -> PixelDraw:
        """Draw pixels with replacement.

        Args:
            image: Which photographs.
            rays: Pixels of each.
            pixels_a_residual: Neighbouring pixels whose residuals agree, as an area.
            generator: Source of randomness.
        """
        number = torch.rand(len(image), rays, generator=generator, dtype=torch.float64).numpy()
        axis = torch.nn.functional.normalize(torch.randn(len(image) * rays, 3, generator=generator), dim=-1)
        pixel, weight = np.empty((len(image), rays), dtype=np.int64), np.empty((len(image), rays))
        for k, i in enumerate(image):
            last = len(self._chance[i]) - 1
            chosen = np.searchsorted(self._cumulative[i], number[k]).clip(0, last)
            weight[k] = 1 / (rays * pixels_a_residual * self._chance[i][chosen])
            pixel[k] = self.data.first_pixel(int(i)) + chosen
        return PixelDraw(image, torch.from_numpy(pixel), axis, weight)


def _chances(colour: Float[NDArray, "h w 3"]) -> Float[NDArray, "p"]:
    slope = np.zeros(colour.shape[:2])
    for axis in (0, 1):
        slope += (np.gradient(colour, axis=axis) ** 2).sum(-1) if colour.shape[axis] > 1 else 0
    slope = np.sqrt(slope).reshape(-1).astype(np.float64)
    alike = np.full(len(slope), 1 / len(slope))
    steep = slope / slope.sum() if slope.sum() > 0 else alike
    return _UNIFORM_SHARE * alike + (1 - _UNIFORM_SHARE) * steep
