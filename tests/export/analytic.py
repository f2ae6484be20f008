"""A solid box known in closed form, and photographs of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from mulan.geometry.camera import PinholeCamera
from mulan.mission.posed_images import PosedImage, PosedImageSet

from ..planning.analytic_engine import BallEngine
from ..reconstruction.cube_scene import look_at

SIDES_M = (1.0, 0.6, 0.4)


@dataclass
class BoxEngine(BallEngine):
    """A box about the origin whose density falls from 200 to 0 per metre over a centimetre."""

    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        outside_m = (points.abs() - points.new_tensor(SIDES_M) / 2).amax(-1)
        return 200.0 * (0.5 - outside_m / 0.01).clamp(0, 1)


def around(folder: Path, count: int = 12) -> PosedImageSet:
    """Cameras above and below the equator of what is at the origin; the pictures do not matter."""
    camera = PinholeCamera(48, 48, 60.0, 60.0, 24.0, 24.0)
    poses = [
        look_at(np.array([2 * np.cos(2.4 * k), 2 * np.sin(2.4 * k), 1.4 * (-1) ** k])) for k in range(count)
    ]
    images = [PosedImage(folder / f"{k}.png", camera, T) for k, T in enumerate(poses)]
    return PosedImageSet(tuple(images), (), folder)
