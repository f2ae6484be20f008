"""Starts drawn from the prior, since a gradient finds the true pose only from nearby."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy.typing import NDArray
from torch import Tensor

from mulan.geometry import se3
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.refinement.gauss_newton import PoseState
from mulan.reconstruction.refinement.pose_prior import PosePrior

_FLAT = 1e-4  # variance of colours below which a picture shows nothing to compare


@dataclass(frozen=True)
class MultiStartConfig:
    """How starts are tried."""

    robot_starts: int = 96
    """Poses of a robot's images tried together, where its errors are joint."""
    robot_images: int = 12
    """Images of each robot these are judged by."""
    image_starts: int = 32
    """Poses tried for each image by itself."""
    lost_starts: int = 96
    """Poses tried for an image that was lost."""
    wide: float = 2.0
    """Every other one is drawn this many times as far from the estimate as localization allows."""
    side: int = 20
    """Rays a side of the pictures compared."""


def spread_starts(
    field: RadianceEngine,
    data: PosedPixels,
    state: PoseState,
    config: MultiStartConfig,
    generator: np.random.Generator,
) -> None:
    """Move each robot, then each image, to whichever draw from its prior looks most like its photographs."""
    prior = state.prior
    if prior.is_joint:
        for robot in np.unique(prior.robot):
            own = np.flatnonzero(prior.robot == robot)
            _start_robot(field, data, state, own, config, generator)
    _start_images(
        field, data, state, np.arange(len(state.T)), state.T, config.image_starts, config, generator
    )


def restart(
    field: RadianceEngine,
    data: PosedPixels,
    state: PoseState,
    lost: Bool[NDArray, "n"],
    config: MultiStartConfig,
    generator: np.random.Generator,
) -> None:
    """Look for lost images anew, before a field that others have learnt meanwhile."""
    chosen = np.flatnonzero(lost)
    if len(chosen):
        # with joint errors an image is where the rest of its robot says
        centre = (state.T if state.prior.is_joint else state.prior.T_world_camera)[chosen]
        _start_images(field, data, state, chosen, centre, config.lost_starts, config, generator)


def _start_images(
    field: RadianceEngine,
    data: PosedPixels,
    state: PoseState,
    chosen: Int[NDArray, "k"],
    centre: Float[NDArray, "k 4 4"],
    starts: int,
    config: MultiStartConfig,
    generator: np.random.Generator,
) -> None:
    conditional = _conditional_blocks(state.prior)[chosen]
    root = np.linalg.cholesky(conditional + 1e-14 * np.eye(6))
    noise = generator.standard_normal((starts, len(chosen), 6))
    noise[1::2] *= config.wide  # one image in fifty lies beyond 2.3 sigmas
    T = centre @ se3.exp((root @ noise[..., None])[..., 0])
    T[0] = state.T[chosen]
    image = state.image[chosen]
    scores = np.stack(
        [correlation(field, data, image, state.frame.to_field(each), config.side) for each in T]
    )
    state.T[chosen] = T[scores.argmax(0), np.arange(len(chosen))]


def _start_robot(
    field: RadianceEngine,
    data: PosedPixels,
    state: PoseState,
    own: Int[NDArray, "k"],
    config: MultiStartConfig,
    generator: np.random.Generator,
) -> None:
    prior, n = state.prior, len(state.T)
    noise = generator.standard_normal((config.robot_starts, 6 * n))
    noise[0] = 0
    T = prior.moved((noise @ prior.root.T).reshape(-1, n, 6))[:, own]
    judged = np.unique(np.linspace(0, len(own) - 1, config.robot_images).astype(int))
    image = state.image[own[judged]]
    scores = [correlation(field, data, image, each[judged], config.side).mean() for each in T]
    state.T[own] = T[int(np.argmax(scores))]


def correlation(
    field: RadianceEngine,
    data: PosedPixels,
    image: Int[NDArray, "n"],
    T: Float[NDArray, "n 4 4"],
    side: int,
) -> Float[NDArray, "n"]:
    """Correlation of the field's pictures with the photographs, on a coarse grid of pixels; -1 where flat.

    An absolute difference would send an object before a white wall out of the view.
    """
    pixel = torch.cat([_grid(data, int(i), side) for i in image])
    poses = data.T_world_camera.clone()
    poses[torch.from_numpy(image)] = torch.from_numpy(T).float()
    batch = data.rays_at(pixel, poses)
    seen = field.render(batch.origins, batch.directions).colour.view(len(image), -1, 3)
    wanted = batch.colours.view(len(image), -1, 3)
    seen, wanted = seen - seen.mean(1, keepdim=True), wanted - wanted.mean(1, keepdim=True)
    a, b = seen.square().mean((1, 2)), wanted.square().mean((1, 2))
    product = (seen * wanted).mean((1, 2)) / (a * b).clamp_min(1e-12).sqrt()
    return torch.where((a > _FLAT) & (b > _FLAT), product, torch.tensor(-1.0)).double().numpy()


def _grid(data: PosedPixels, image: int, side: int) -> Int[Tensor, "p"]:
    h, w = data.images[image].colour.shape[:2]
    row = ((torch.arange(side) + 0.5) * h / side).long()
    column = ((torch.arange(side) + 0.5) * w / side).long()
    return data.first_pixel(image) + (row[:, None] * w + column).reshape(-1)


def _conditional_blocks(prior: PosePrior) -> Float[NDArray, "n 6 6"]:
    """Covariance of each image's pose if all others were known."""
    if not prior.is_joint:
        return prior.covariance
    n = len(prior.T_world_camera)
    blocks = np.einsum("iaib->iab", prior.precision.reshape(n, 6, n, 6))
    return np.linalg.inv(blocks)
