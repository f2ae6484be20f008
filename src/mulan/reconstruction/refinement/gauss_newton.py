"""Most probable camera poses before a field that is held still: photographs and prior together."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels
from mulan.reconstruction.refinement.photometric import (
    photometric_cost,
    photometric_terms,
)
from mulan.reconstruction.refinement.pose_prior import PosePrior

_FIRST_DAMPING = 1e-3
_DAMPING_RANGE = 1e-6, 1e6


@dataclass
class PoseState:
    """Where the uncertain images are believed to be, as refinement goes on.

    Attributes:
        image: Which images of the set.
        prior: What localization said.
        T: Poses now.
        damping: Levenberg-Marquardt's, of each image.
        sigma: Robust residual of each image at the last step; infinite before the first.
    """

    image: Int[NDArray, "n"]
    prior: PosePrior
    T: Float[NDArray, "n 4 4"]
    damping: Float[NDArray, "n"]
    sigma: Float[NDArray, "n"]

    @staticmethod
    def at_prior(image: Int[NDArray, "n"], prior: PosePrior) -> "PoseState":
        """Start at localization's estimates."""
        n = len(image)
        return PoseState(
            image, prior, prior.T_world_camera.copy(), np.full(n, _FIRST_DAMPING), np.full(n, np.inf)
        )

    def place(self, data: PosedPixels) -> None:
        """Make a set of photographs learn from these poses."""
        poses = data.T_world_camera.clone()
        poses[torch.from_numpy(self.image)] = torch.from_numpy(self.T).float().to(poses.device)
        data.T_world_camera = poses


def gauss_newton_step(
    field: RadianceEngine,
    compared: ComparedPixels,
    state: PoseState,
    rays: int,
    pixels_a_residual: float,
    generator: torch.Generator,
    step_share: float = 1.0,
) -> Bool[NDArray, "n"]:
    """Move every pose once; each image's move is kept only if its own cost falls on the same pixels.

    Args:
        field: What the cameras look at.
        compared: Photographs and the pixels to draw.
        state: Poses, changed in place.
        rays: Pixels of each image.
        pixels_a_residual: Neighbouring pixels whose residuals agree, as an area.
        generator: Source of randomness.
        step_share: Share of the step taken; below 1 later steps average the noise of their draws.

    Returns:
        Which moves were kept.
    """
    data, draw = compared.data, compared.draw(state.image, rays, pixels_a_residual, generator)
    terms = photometric_terms(field, data, draw, state.T)
    precision, residual = state.prior.precision(), state.prior.residual(state.T)
    pull = _times(precision, residual)
    step = _solve(terms.information, state.damping, precision, terms.gradient + pull)
    T = state.T @ se3.exp(-step_share * step)
    moved = state.prior.residual(T)
    before = terms.cost + 0.5 * (residual * pull).sum(1)
    after = photometric_cost(field, data, draw, T, terms.sigma) + 0.5 * (
        moved * _times(precision, moved)
    ).sum(1)
    kept = after <= before
    state.T = np.where(kept[:, None, None], T, state.T)
    state.damping = np.clip(np.where(kept, state.damping / 4, state.damping * 8), *_DAMPING_RANGE)
    state.sigma = terms.sigma
    return kept


def posterior_covariance(
    field: RadianceEngine,
    compared: ComparedPixels,
    state: PoseState,
    rays: int,
    pixels_a_residual: float,
    generator: torch.Generator,
) -> Float[NDArray, "n 6 6"]:
    """Marginal covariance of each refined pose (Laplace's approximation, the field taken as known)."""
    data, draw = compared.data, compared.draw(state.image, rays, pixels_a_residual, generator)
    information = photometric_terms(field, data, draw, state.T).information
    precision = state.prior.precision()
    if not state.prior.is_joint:
        return np.linalg.inv(precision + information)
    covariance = np.linalg.inv(precision + _block_diagonal(information))
    n = len(state.T)
    return np.einsum("iaib->iab", covariance.reshape(n, 6, n, 6)).copy()


def _times(
    precision: Float[NDArray, "m m"] | Float[NDArray, "n 6 6"], x: Float[NDArray, "n 6"]
) -> Float[NDArray, "n 6"]:
    if precision.ndim == 3:
        return (precision @ x[..., None])[..., 0]
    return (precision @ x.reshape(-1)).reshape(x.shape)


def _solve(
    information: Float[NDArray, "n 6 6"],
    damping: Float[NDArray, "n"],
    precision: Float[NDArray, "m m"] | Float[NDArray, "n 6 6"],
    gradient: Float[NDArray, "n 6"],
) -> Float[NDArray, "n 6"]:
    diagonal = np.einsum("naa->na", information) * damping[:, None]
    damped = information + diagonal[..., None] * np.eye(6)
    if precision.ndim == 3:
        return np.linalg.solve(precision + damped, gradient[..., None])[..., 0]
    return np.linalg.solve(precision + _block_diagonal(damped), gradient.reshape(-1)).reshape(gradient.shape)


def _block_diagonal(blocks: Float[NDArray, "n 6 6"]) -> Float[NDArray, "m m"]:
    n = len(blocks)
    out = np.zeros((n, 6, n, 6))
    out[np.arange(n), :, np.arange(n), :] = blocks
    return out.reshape(6 * n, 6 * n)
