"""Where a video's camera goes: around the scene, or along the robots' own ways, smoothed."""

from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.reconstruction.camera_paths import orbit

CameraView = tuple[PinholeCamera, Float[NDArray, "4 4"]]

_STILL = 1e-6  # photographs from one place must not stop the video


def camera_path(
    images: PosedImageSet, path: Literal["orbit", "robots"], frames: int, smoothing: float
) -> list[CameraView]:
    """Cameras of a video's frames; the lens is the first photograph's, without its distortion.

    Args:
        images: Training photographs.
        path: One turn around the scene, or every robot's way in turn.
        frames: Pictures in all.
        smoothing: Standard deviation of the smoothing along the robots' ways, in photographs.
    """
    lens = replace(images.train[0].camera, k1=0.0, k2=0.0, p1=0.0, p2=0.0, k3=0.0)
    if path == "orbit":
        return [(lens, T) for _, T in orbit(images, frames)]
    ways: dict[str | None, list[PosedImage]] = {}
    for image in images.train:
        ways.setdefault(image.robot_id, []).append(image)
    views: list[CameraView] = []
    for number, way in enumerate(ways.values()):
        way.sort(key=lambda image: image.timestamp_s or 0.0)
        share = frames * (number + 1) // len(ways) - frames * number // len(ways)
        views += [
            (lens, T) for T in smoothed_way(np.stack([i.T_world_camera for i in way]), share, smoothing)
        ]
    return views


def smoothed_way(T: Float[NDArray, "n 4 4"], frames: int, smoothing: float) -> Float[NDArray, "frames 4 4"]:
    """Poses at an even pace along a way, position and rotation both counted, smoothed.

    Args:
        T: Poses in order.
        frames: How many to make.
        smoothing: Standard deviation in poses of the way.
    """
    if frames == 0 or len(T) == 1:
        return np.repeat(T[:1], frames, axis=0)
    steps = se3.log(se3.inverse(T[:-1]) @ T[1:])
    move_m, turn_rad = np.linalg.norm(steps[:, 3:], axis=1), np.linalg.norm(steps[:, :3], axis=1)
    # a turn of one radian takes as long as moving by the way's typical distance a radian
    metres_a_radian = move_m.sum() / max(float(turn_rad.sum()), 1e-9)
    passed = np.concatenate([[0.0], np.cumsum(move_m + metres_a_radian * turn_rad + _STILL)])
    even = se3.interpolate(passed, T, np.linspace(0, passed[-1], frames))
    sigma = smoothing * frames / len(T)
    if sigma <= 0 or frames < 2:
        return even
    flat = even[:, :3, :].reshape(frames, 12)
    smooth = gaussian_filter1d(flat, sigma, axis=0, mode="nearest").reshape(frames, 3, 4)
    U, _, Vt = np.linalg.svd(smooth[:, :, :3])
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]  # the nearest rotation, never a mirror
    return se3.from_parts(U @ Vt, smooth[:, :, 3])
