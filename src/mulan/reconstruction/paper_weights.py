"""The paper's weights: one number an image from the area of its position's error ellipse."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import gammaincinv
from torch import Tensor

from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.weights import Weighting


@dataclass(frozen=True)
class PaperWeights(Weighting):
    """The paper's equation as printed: ``SIGMOID(γ)``, ``γ = k² π a b``, ``k = √(-2 log(1-CI))``.

    a and b are the standard deviations of the camera's position along the world's x and y axes, in metres,
    which is what the printed a², b² are (row 8 of the reading notes). The weight **rises** with uncertainty,
    from 1/2 for an exact pose towards 1, against the paper's own text (row 12), and depends on the unit of
    length; it is here to be reproduced and compared.
    """

    confidence: float = 0.95
    """CI, the probability inside the error ellipse."""

    def gamma(self, image: CapturedImage) -> float:
        """Area of the horizontal error ellipse [m²]; 0 for an exact pose."""
        position = position_covariance(image)
        return chi2_2d(self.confidence) * math.pi * math.sqrt(position[0, 0] * position[1, 1])

    def weight_map(self, image: CapturedImage, space: SceneSpace) -> Float[Tensor, "h w"]:  # noqa: ARG002
        """One number for the whole image (row 13: its own covariance, not its robot's)."""
        return torch.full(image.colour.shape[:2], 1 / (1 + math.exp(-self.gamma(image))))


@dataclass(frozen=True)
class PaperCorrectedWeights(Weighting):
    """What the paper's text asks for: ``2 SIGMOID(-γ/γ₀)``, which falls from 1 as uncertainty grows.

    γ is the area of the true error ellipse, from the eigenvalues of the position's covariance, so it does not
    depend on where the world's axes point (row 8); the covariance is in metres and radians, so κ has been
    calibrated before it came here (row 11); γ₀ carries the unit of γ (row 12); each image has its own (row
    13).
    """

    gamma_0_m2: float = 0.02
    """γ₀ [m²], the scale on which trust falls: an ellipse three times as large has a weight of 0.1."""
    confidence: float = 0.95
    """CI, the probability inside the error ellipse."""
    spatial: bool = False
    """Take the ellipsoid in space (χ² of three degrees of freedom) instead of the ellipse on the ground; its
    γ is the area of the disc as wide as the ball of the same volume."""

    def gamma(self, image: CapturedImage) -> float:
        """Area of the error ellipse [m²]; 0 for an exact pose."""
        position = position_covariance(image)
        if self.spatial:
            semi_axes_product = math.sqrt(max(float(np.linalg.det(position)), 0.0))
            return chi2_3d(self.confidence) * math.pi * semi_axes_product ** (2 / 3)
        return (
            chi2_2d(self.confidence) * math.pi * math.sqrt(max(float(np.linalg.det(position[:2, :2])), 0.0))
        )

    def weight_map(self, image: CapturedImage, space: SceneSpace) -> Float[Tensor, "h w"]:  # noqa: ARG002
        """One number for the whole image."""
        weight = 1 - math.tanh(0.5 * self.gamma(image) / self.gamma_0_m2)  # = 2 SIGMOID(-γ/γ₀)
        return torch.full(image.colour.shape[:2], weight)


def position_covariance(image: CapturedImage) -> Float[NDArray, "3 3"]:
    """Covariance of the camera's position in the world's axes [m²]; zero for an exact pose."""
    covariance = image.posed.pose_covariance
    if covariance is None:
        return np.zeros((3, 3))
    R = image.T_world_camera[:3, :3]
    return R @ covariance[3:, 3:] @ R.T


def chi2_2d(confidence: float) -> float:
    """k² of two degrees of freedom: ``-2 log(1-CI)``."""
    return -2 * math.log(1 - confidence)


def chi2_3d(confidence: float) -> float:
    """k² of three degrees of freedom."""
    return 2 * float(gammaincinv(1.5, confidence))
