"""A coarse grid of a camera's rays, as the field takes them."""

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.geometry.camera import PinholeCamera


def camera_rays(
    camera: PinholeCamera, T_world_camera: Float[NDArray, "4 4"], columns: int
) -> tuple[Float[Tensor, "r 3"], Float[Tensor, "r 3"]]:
    """World origins and unit directions of a ``columns``-wide grid over the image, row by row."""
    return rays_of_poses(camera, T_world_camera[None], columns)


def rays_of_poses(
    camera: PinholeCamera, T_world_camera: Float[NDArray, "n 4 4"], columns: int
) -> tuple[Float[Tensor, "r 3"], Float[Tensor, "r 3"]]:
    """The same grid from several poses, one after another."""
    in_camera = camera.resized(columns, rows_for(camera, columns)).pixel_directions().reshape(-1, 3)
    directions = (in_camera @ np.swapaxes(T_world_camera[:, :3, :3], 1, 2)).reshape(-1, 3)
    origins = torch.tensor(T_world_camera[:, :3, 3], dtype=torch.float32)
    return origins.repeat_interleave(len(in_camera), 0), torch.tensor(directions, dtype=torch.float32)


def rows_for(camera: PinholeCamera, columns: int) -> int:
    """Rows that keep the image's aspect."""
    return max(1, round(columns * camera.height / camera.width))
