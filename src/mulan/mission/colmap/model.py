"""What a COLMAP sparse model holds, in our conventions."""

from collections.abc import Mapping
from dataclasses import dataclass

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera


@dataclass(frozen=True)
class ColmapImage:
    """One registered photograph.

    Attributes:
        name: File below the model's image folder.
        camera_id: Key of its camera.
        T_world_camera: Camera pose, OpenGL axes (COLMAP itself has the inverse, on optical axes).
    """

    name: str
    camera_id: int
    T_world_camera: Float[NDArray, "4 4"]


@dataclass(frozen=True)
class ColmapModel:
    """Cameras by their ids, and the images they took.

    Pixel centres are at +0.5 in COLMAP as here, so intrinsics need no shift.
    """

    cameras: Mapping[int, PinholeCamera]
    images: tuple[ColmapImage, ...]
