"""Most probable camera poses before a field that is held still: photographs and prior together."""

from dataclasses import dataclass
from dataclasses import field as dataclass_field

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels
from mulan.reconstruction.refinement.field_frame import FieldFrame
from mulan.reconstruction.refinement.photometric import (
    PhotometricTerms,
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
        frame: Where the field that registration looks at lies in the world. It begins at home, and moves and
            grows if no image is exact: the poses and the field do so together at no cost but the prior's.
    """

    image: Int[NDArray, "n"]
    prior: PosePrior
    T: Float[NDArray, "n 4 4"]
    damping: Float[NDArray, "n"]
    sigma: Float[NDArray, "n"]
    frame: FieldFrame = dataclass_field(default_factory=FieldFrame)

    @staticmethod
    def at_prior(image: Int[NDArray, "n"], prior: PosePrior) -> "PoseState":
        """Start at localization's estimates."""
        n = len(image)
        return PoseState(
            image, prior, prior.T_world_camera.copy(), np.full(n, _FIRST_DAMPING), np.full(n, np.inf)
        )

    @property
    def best_known(self) -> int:
        """Which of them has the position localization knows best."""
        return int(np.argmin(np.einsum("naa->n", self.prior.blocks[:, 3:, 3:])))

    def subset(self, kept: Bool[NDArray, "n"], image: Int[NDArray, "k"]) -> "PoseState":
        """Some of the images, by their numbers in a set without the others."""
        prior, T = self.prior.subset(kept), self.T[kept]
        return PoseState(image, prior, T, self.damping[kept], self.sigma[kept], self.frame)

    def begin_anew(self) -> None:
        """Forget what steps before an earlier field did: their damping, and where that field lay."""
        self.damping = np.full(len(self.T), _FIRST_DAMPING)
        self.frame = FieldFrame()

    def place(self, data: PosedPixels) -> None:
        """Make a set of photographs learn from these poses."""
        poses = data.T_world_camera.clone()
        poses[torch.from_numpy(self.image)] = (
            torch.from_numpy(self.frame.to_field(self.T)).float().to(poses.device)
        )
        data.T_world_camera = poses


def gauss_newton_step(
    field: RadianceEngine,
    compared: ComparedPixels,
    state: PoseState,
    rays: int,
    pixels_a_residual: float,
    generator: torch.Generator,
    step_share: float = 1.0,
    frame_is_free: bool = False,
) -> Bool[NDArray, "n"]:
    """Move every pose once; each image's move is kept only if its own cost falls on the same pixels.

    Where errors are joint that of a robot's images together counts: one that stayed would hold back all
    the others, which are tied to it.

    If no image is exact, one that localization knows well cannot pull the field to itself, nor what it knows
    of a robot's whole path the field's size: all the others hold it. A free frame lets field and poses move
    and grow together, as the prior asks.

    Args:
        field: What the cameras look at.
        compared: Photographs and the pixels to draw.
        state: Poses, changed in place.
        rays: Pixels of each image.
        pixels_a_residual: Neighbouring pixels whose residuals agree, as an area.
        generator: Source of randomness.
        step_share: Share of the step taken; below 1 later steps average the noise of their draws.
        frame_is_free: Whether the field's place and size in the world are unknown too.

    Returns:
        Which moves were kept.
    """
    data, draw = compared.data, compared.draw(state.image, rays, pixels_a_residual, generator)
    frame = state.frame
    terms = photometric_terms(field, data, draw, frame.to_field(state.T)).by_metres(frame.metres_per_unit)
    precision, residual = state.prior.precision, state.prior.residual(state.T)
    pull = _times(precision, residual)
    if frame_is_free:
        step, shift = _solve_with_frame(terms, state, precision, pull)
        frame = frame.moved(-step_share * shift)
    else:
        step = _solve(terms.information, state.damping, precision, terms.gradient + pull)
    T = state.T @ se3.exp(-step_share * step)
    moved = state.prior.residual(T)
    before = terms.cost + 0.5 * (residual * pull).sum(1)
    after = photometric_cost(field, data, draw, frame.to_field(T), terms.sigma)
    after += 0.5 * (moved * _times(precision, moved)).sum(1)
    kept = _by_robot(state.prior, before - after) >= 0
    # those that stay where they were before the field go where it goes
    along = frame.to_world(state.frame.to_field(state.T))
    state.T, state.frame = np.where(kept[:, None, None], T, along), frame
    state.damping = np.clip(np.where(kept, state.damping / 4, state.damping * 8), *_DAMPING_RANGE)
    state.sigma = terms.sigma
    return kept


def _by_robot(prior: PosePrior, value: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
    """Sum over the images of the same robot if their errors are joint, else the value itself."""
    return np.bincount(prior.robot, value)[prior.robot] if prior.is_joint else value


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


def _solve_with_frame(
    terms: PhotometricTerms,
    state: PoseState,
    precision: Float[NDArray, "m m"] | Float[NDArray, "n 6 6"],
    pull: Float[NDArray, "n 6"],
) -> tuple[Float[NDArray, "n 6"], Float[NDArray, "7"]]:
    """Steps of the poses and of the field's frame."""
    n = len(state.T)
    along = state.frame.carries(state.T)
    shifts = along.shape[-1]
    damped = terms.information + np.einsum("naa->na", terms.information)[..., None] * (
        state.damping[:, None, None] * np.eye(6)
    )
    known = precision if precision.ndim == 2 else _block_diagonal(precision)
    system = np.zeros((6 * n + shifts, 6 * n + shifts))
    system[:-shifts, :-shifts] = known + _block_diagonal(damped)
    coupling = -(terms.information @ along).reshape(6 * n, shifts)
    system[:-shifts, -shifts:], system[-shifts:, :-shifts] = coupling, coupling.T
    by_frame = np.einsum("nab,nac,ncd->bd", along, terms.information, along)
    system[-shifts:, -shifts:] = by_frame + 1e-6 * np.diag(np.diag(by_frame))
    right = np.concatenate(
        [(terms.gradient + pull).reshape(-1), -np.einsum("nab,na->b", along, terms.gradient)]
    )
    solution = np.linalg.solve(system, right)
    return solution[:-shifts].reshape(n, 6), solution[-shifts:]


def _block_diagonal(blocks: Float[NDArray, "n 6 6"]) -> Float[NDArray, "m m"]:
    n = len(blocks)
    out = np.zeros((n, 6, n, 6))
    out[np.arange(n), :, np.arange(n), :] = blocks
    return out.reshape(6 * n, 6 * n)
