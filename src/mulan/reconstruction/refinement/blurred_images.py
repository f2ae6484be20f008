"""Photographs made smooth, so that a pose several pixels off still finds its way."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from mulan.reconstruction.captured_image import CapturedImage


def blurred(images: Sequence[CapturedImage], radius_px: int) -> tuple[CapturedImage, ...]:
    """Each pixel the mean of the square of ``2 radius + 1`` pixels about it, edges repeated."""
    if radius_px < 1:
        return tuple(images)
    return tuple(
        replace(
            image,
            colour=_box(image.colour, radius_px),
            alpha=None if image.alpha is None else _box(image.alpha, radius_px),
        )
        for image in images
    )


def _box(pixels: UInt8[NDArray, "h w *c"], radius_px: int) -> UInt8[NDArray, "h w *c"]:
    size = 2 * radius_px + 1
    mean = uniform_filter(pixels.astype(np.float32), size, mode="nearest", axes=(0, 1))
    return np.round(mean).astype(np.uint8)
