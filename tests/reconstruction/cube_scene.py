"""A cube whose colour is its surface position, photographed exactly."""

from pathlib import Path

import numpy as np

from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.pixels import encode_png
from mulan.mission.posed_images import PosedImage, PosedImageSet

HALF_SIDE_M = 0.5


def look_at(position, target=(0.0, 0.0, 0.0)):
    back = np.asarray(position, float) - target
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    return se3.from_parts(np.stack([right, np.cross(back, right), back], 1), np.asarray(position, float))


def photograph(camera, T):
    """RGBA 8-bit picture; transparent where the cube is not."""
    directions = camera.pixel_directions() @ T[:3, :3].T
    origin = T[:3, 3]
    with np.errstate(divide="ignore"):
        a, b = (-HALF_SIDE_M - origin) / directions, (HALF_SIDE_M - origin) / directions
    near, far = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    hit = near < far
    surface = origin + np.where(hit, near, 0.0)[..., None] * directions
    rgba = np.concatenate([surface + HALF_SIDE_M, np.ones((*hit.shape, 1))], -1) * hit[..., None]
    return (rgba.clip(0, 1) * 255).round().astype(np.uint8)


def cube_images(folder: Path, train=10, test=2, side=24, opaque=False, covariance=None) -> PosedImageSet:
    camera = PinholeCamera(side, side, side * 1.2, side * 1.2, side / 2, side / 2)
    images = []
    for i in range(train + test):
        azimuth, height = 2.4 * i, -1.0 + 2.5 * ((i * 0.618) % 1)
        T = look_at(np.array([2.5 * np.cos(azimuth), 2.5 * np.sin(azimuth), height]))
        pixels = photograph(camera, T)
        path = folder / f"{i:02d}.png"
        path.write_bytes(encode_png(np.ascontiguousarray(pixels[..., :3]) if opaque else pixels))
        images.append(PosedImage(path, camera, T, covariance))
    return PosedImageSet(tuple(images[:train]), tuple(images[train:]), folder)
