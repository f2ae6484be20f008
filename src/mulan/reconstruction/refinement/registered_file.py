"""Poses after registration on disk, and which of them are doubted."""

import hashlib
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool
from numpy.typing import NDArray

from mulan.mission.posed_images import PosedImageSet
from mulan.reconstruction.field_file import read_tensors, write_tensors
from mulan.reconstruction.refinement.gauss_newton import PoseState
from mulan.reconstruction.refinement.refinement_config import RefinementConfig
from mulan.reconstruction.robot_exposure import RobotExposure


def write_registered(
    path: Path,
    state: PoseState,
    doubted: Bool[NDArray, "n"],
    images: PosedImageSet,
    config: RefinementConfig,
    seed: int,
    seconds: float,
    exposure: RobotExposure | None = None,
) -> None:
    """Write the poses, gains if they were fitted, and what they were made from."""
    header = {"made_from": _made_from(state, images, config, seed, exposure), "seconds": seconds}
    tensors = {
        "T_world_camera": torch.from_numpy(state.T.copy()),
        "doubted": torch.from_numpy(doubted.astype(np.uint8)),
    }
    write_tensors(path, tensors | (exposure.state() if exposure else {}), header)


def read_registered(
    path: Path,
    state: PoseState,
    images: PosedImageSet,
    config: RefinementConfig,
    seed: int,
    exposure: RobotExposure | None = None,
) -> tuple[Bool[NDArray, "n"], float] | None:
    """Take over the poses, and gains if they are fitted, of a file made from the same.

    Returns:
        Which are doubted, and the seconds they took; None if there is no such file.

    Raises:
        InputError: The file is damaged.
    """
    if not path.exists():
        return None
    tensors, header = read_tensors(path)
    if header.get("made_from") != _made_from(state, images, config, seed, exposure):
        return None
    if exposure:
        exposure.load_state(tensors)
    state.T = tensors["T_world_camera"].double().numpy().copy()
    return tensors["doubted"].numpy().astype(bool), float(header["seconds"])


def _made_from(
    state: PoseState,
    images: PosedImageSet,
    config: RefinementConfig,
    seed: int,
    exposure: RobotExposure | None,
) -> str:
    digest = hashlib.sha256(f"{config} {seed} {exposure and exposure.config}".encode())
    for image in images.train:
        size = image.path.stat().st_size if image.path.exists() else -1
        digest.update(f"{image.path.name} {size} {image.camera} {image.robot_id}".encode())
        digest.update(image.T_world_camera.tobytes())
    digest.update(state.prior.covariance.tobytes())
    return digest.hexdigest()[:16]
