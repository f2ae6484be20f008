"""How far each pixel is trusted, from how well its camera's pose is known."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from torch import Tensor

from mulan.geometry import so3
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage


class Weighting(ABC):
    """Gives every pixel of every image a weight in its ray's loss."""

    @abstractmethod
    def weight_map(self, image: CapturedImage, space: SceneSpace) -> Float[Tensor, "h w"]:
        """Weight of each pixel of one image, before any comparison with the others."""

    def relative(self, weight_map: Float[Tensor, "h w"], best_mean: float) -> Float[Tensor, "h w"]:  # noqa: ARG002
        """The final weights, given the largest mean any map of the set has; zero means ignored."""
        return weight_map

    def ignored(self, images: Sequence[CapturedImage], space: SceneSpace) -> list[bool]:  # noqa: ARG002
        """Which images of a set are not learnt from at all, however their pixels would be weighted."""
        return [False] * len(images)

    def raw_maps(self, images: Sequence[CapturedImage], space: SceneSpace) -> Iterator[Float[Tensor, "_ _"]]:
        """Maps of all images of a set before any comparison, zero for those ignored."""
        for image, ignored in zip(images, self.ignored(images, space), strict=True):
            yield torch.zeros(image.colour.shape[:2]) if ignored else self.weight_map(image, space)

    def weight_maps(self, images: Sequence[CapturedImage], space: SceneSpace) -> list[Float[Tensor, "_ _"]]:
        """Weights of all images of a set."""
        maps = list(self.raw_maps(images, space))
        best = max((float(m.mean()) for m in maps), default=1.0)
        return [self.relative(m, best) for m in maps]


@dataclass(frozen=True)
class NoWeights(Weighting):
    """Every pixel counts the same."""

    def weight_map(self, image: CapturedImage, space: SceneSpace) -> Float[Tensor, "h w"]:  # noqa: ARG002
        """All ones."""
        return torch.ones(image.colour.shape[:2])


@dataclass(frozen=True)
class UncertaintyWeights(Weighting):
    """Inverse variance of the colour a pixel would take if its camera stood elsewhere: ``s₀²/(s₀² + v)``.

    v is the variance of the captured image within a Gaussian of σ pixels, σ being how far the pose's
    uncertainty moves the scene's centre in the image (row 16's ``(∂C/∂o) Σ (∂C/∂o)ᵀ``, without its
    linearisation, which does not hold over several pixels). Flat regions stay trusted, edges do not.

    An image displaced by many pixels teaches a wrong scene even where it is flat, so the whole image is
    ignored if σ exceeds a limit: what others see well is better learnt without it. Where too few are within
    the limit nobody else sees the scene well, and all are kept.
    """

    colour_variance: float = 0.005
    """s₀²: colour variance of a pixel whose pose is exact."""
    threshold: float = 0.01
    """Weights below this share of the best image become zero (a mean weight of 0.002 still cost 2.7 dB)."""
    most_sigma_px: float = 1.0
    """Images with a larger σ, in pixels of the size learnt from, are ignored."""
    least_within: float = 0.25
    """Share of the images that must be within the limit for the others to be ignored."""

    def weight_map(self, image: CapturedImage, space: SceneSpace) -> Float[Tensor, "h w"]:
        """``s₀²/(s₀² + v)``."""
        variance = local_variance(image.colour_fraction, projected_sigma_px(image, space))
        return torch.from_numpy(self.colour_variance / (self.colour_variance + variance)).float()

    def ignored(self, images: Sequence[CapturedImage], space: SceneSpace) -> list[bool]:
        """Images whose σ exceeds the limit, where enough others are within it."""
        beyond = np.array([projected_sigma_px(image, space) > self.most_sigma_px for image in images])
        if (~beyond).mean() < self.least_within:
            return [False] * len(images)
        return beyond.tolist()

    def relative(self, weight_map: Float[Tensor, "h w"], best_mean: float) -> Float[Tensor, "h w"]:
        """Relative to the best image's mean, at most 1, zero below the threshold."""
        relative = (weight_map / best_mean).clamp_max(1.0)
        return torch.where(relative < self.threshold, 0.0, relative)


def projected_sigma_px(image: CapturedImage, space: SceneSpace) -> float:
    """Standard deviation [pixels, mean over the two axes] of the image of a point straight ahead.

    The point lies at the depth of the scene's centre (at least a tenth of its radius); a right perturbation
    (w, v) of the camera moves it by ``hat(p) w - v`` in the camera frame.
    """
    covariance = image.posed.pose_covariance
    if covariance is None:
        return 0.0
    T, camera = image.T_world_camera, image.camera
    ahead_m = float((np.array(space.centre_m) - T[:3, 3]) @ -T[:3, 2])
    depth_m = max(ahead_m, 0.1 * space.radius_m)
    moved = np.concatenate([so3.hat(np.array([0.0, 0.0, -depth_m])), -np.eye(3)], axis=1)
    J = np.array([[camera.fx, 0.0, 0.0], [0.0, -camera.fy, 0.0]]) @ moved / depth_m
    return math.sqrt(max(float(np.trace(J @ covariance @ J.T)) / 2, 0.0))


def local_variance(colour: Float[NDArray, "h w 3"], sigma_px: float) -> Float[NDArray, "h w"]:
    """Variance of the colour under a Gaussian window, averaged over the channels."""
    if sigma_px < 1e-3:
        return np.zeros(colour.shape[:2])
    # beyond the image's own size a wider window sees nothing new
    sigma = min(sigma_px, max(colour.shape[:2]))
    blur = (sigma, sigma, 0)
    colour = colour.astype(float)
    mean = gaussian_filter(colour, blur, mode="nearest")
    square = gaussian_filter(colour**2, blur, mode="nearest")
    return (square - mean**2).clip(0).mean(-1)
