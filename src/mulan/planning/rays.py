"""A coarse grid of a camera's rays, as the field takes them."""

import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.geometry.camera import PinholeCamera


def camera_rays(
    camera: PinholeCamera, T_world_camera: Float[NDArray, "4 4"], columns: int
) -> tuple[Float[Tensor, "r 3"], Float[Tensor, "r 3"]]:
    """World origins and unit directions of a ``columns``-wide grid over the image, row by row."""
    grid = camera.resized(columns, rows_for(camera, columns))
    directions = grid.pixel_directions().reshape(-1, 3) @ T_world_camera[:3, :3].T
    origin = torch.tensor(T_world_camera[:3, 3], dtype=torch.float32)
    return origin.repeat(len(directions), 1), torch.tensor(directions, dtype=torch.float32)


def rows_for(camera: PinholeCamera, columns: int) -> int:
    """Rows that keep the image's aspect."""
    return max(1, round(columns * camera.height / camera.width))
