"""Camera paths to show a scene with."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.geometry.alignment import point_nearest_to_axes
from mulan.geometry.camera import PinholeCamera
from mulan.mission.posed_images import PosedImageSet


def orbit(images: PosedImageSet, frames: int) -> list[tuple[PinholeCamera, Float[NDArray, "4 4"]]]:
    """One turn around what the photographs look at, at their median distance and height.

    Args:
        images: Training photographs; the lens is the first one's.
        frames: Poses on the circle.
    """
    T = np.stack([image.T_world_camera for image in images.train])
    position_m = T[:, :3, 3]
    centre_m = point_nearest_to_axes(position_m, -T[:, :3, 2])
    offset_m = position_m - centre_m
    radius_m = float(np.median(np.hypot(offset_m[:, 0], offset_m[:, 1])))
    height_m = float(np.median(offset_m[:, 2]))
    start_rad = np.arctan2(offset_m[0, 1], offset_m[0, 0])
    angle = start_rad + np.arange(frames) * 2 * np.pi / frames
    offset = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(frames, height_m)], -1)
    back = offset / np.linalg.norm(offset, axis=1, keepdims=True)
    right = np.stack([-np.sin(angle), np.cos(angle), np.zeros(frames)], -1)
    R = np.stack([right, np.cross(back, right), back], -1)
    camera = images.train[0].camera
    return [(camera, pose) for pose in se3.from_parts(R, centre_m + offset)]
