"""The photographs a peer trains on and is scored on: the same pixels, size and split as mulan's own.

Stands alone (numpy and Pillow only), since it runs under the peer's Python, where mulan is not installed.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image


@dataclass(frozen=True)
class Camera:
    """Pinhole intrinsics in pixels (centres at +0.5), OpenCV distortion ``(k1, k2, p1, p2)``."""

    width: int
    height: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float]


@dataclass(frozen=True)
class View:
    """One photograph, colour premultiplied by ``alpha``, and ``T_world_camera`` (4, 4), OpenGL axes."""

    rgb: NDArray[Any]
    alpha: NDArray[Any]
    T_world_camera: NDArray[np.float64]

    def over(self, background: tuple[float, float, float]) -> NDArray[Any]:
        """The photograph (h, w, 3) over a background colour."""
        return self.rgb + (1 - self.alpha) * np.asarray(background, np.float32)

    @property
    def over_white(self) -> NDArray[Any]:
        """The photograph over white, as it is scored."""
        return self.over((1.0, 1.0, 1.0))


@dataclass(frozen=True)
class Scene:
    """One camera, training and test views; ``is_object`` where the set has masks and a closed outer bound."""

    name: str
    camera: Camera
    train: list[View]
    test: list[View]
    is_object: bool


def read_scene(folder: Path, longest_side: int, hold_out_every: int) -> Scene:
    """A Blender set (``transforms_train.json`` and ``_test``) or a nerfstudio one (``transforms.json``).

    In the latter, frames 0, n, 2n, ... in file order are the test views.

    Raises:
        SystemExit: The folder holds neither, or a file of it is missing.
    """
    try:
        if (folder / "transforms_train.json").exists():
            train, camera, has_mask = _read_frames(folder, "transforms_train.json", longest_side)
            test, _, _ = _read_frames(folder, "transforms_test.json", longest_side)
            return Scene(folder.name, camera, train, test, is_object=has_mask)
        views, camera, has_mask = _read_frames(folder, "transforms.json", longest_side)
    except OSError as error:
        raise SystemExit(f"{folder}: cannot read the image set ({error})") from error
    test = views[::hold_out_every]
    train = [view for i, view in enumerate(views) if i % hold_out_every]
    return Scene(folder.name, camera, train, test, is_object=has_mask)


def area_resized(pixels: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    """Exact average over areas, (h, w, c) to (height, width, c), as mulan/mission/pixels.py resizes."""
    rows = np.tensordot(_area_weights(pixels.shape[0], height), pixels, axes=(1, 0))
    return np.tensordot(rows, _area_weights(pixels.shape[1], width), axes=(1, 1)).transpose(0, 2, 1)


def _area_weights(size: int, new_size: int) -> NDArray[Any]:
    """Row i averages the stretch of input pixels that output pixel i covers, edges in part."""
    edges = np.linspace(0, size, new_size + 1)
    pixel = np.arange(size)
    overlap = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
    return (np.clip(overlap, 0, None) * (new_size / size)).astype(np.float32)


def _read_frames(folder: Path, file: str, longest_side: int) -> tuple[list[View], Camera, bool]:
    meta = json.loads((folder / file).read_text())
    views, size, has_mask = [], (0, 0), False
    for frame in meta["frames"]:
        path = folder / frame["file_path"]
        with Image.open(path if path.suffix else path.with_suffix(".png")) as image:
            has_mask = "A" in image.mode
            size = image.size
            pixels = np.asarray(image.convert("RGBA"), np.float32) / 255
        pixels[..., :3] *= pixels[..., 3:]
        scale = min(1.0, longest_side / max(size))
        pixels = area_resized(pixels, round(size[0] * scale), round(size[1] * scale))
        T_world_camera = np.asarray(frame["transform_matrix"], np.float64)
        views.append(View(pixels[..., :3].copy(), pixels[..., 3:].copy(), T_world_camera))
    height, width = views[0].rgb.shape[:2]
    return views, _camera(meta, size, width, height), has_mask


def _camera(meta: dict[str, Any], size: tuple[int, int], width: int, height: int) -> Camera:
    w, h = meta.get("w", size[0]), meta.get("h", size[1])
    x, y = width / w, height / h
    k1, k2, p1, p2 = (float(meta.get(name, 0.0)) for name in ("k1", "k2", "p1", "p2"))
    if "fl_x" in meta:
        fl_x, fl_y = meta["fl_x"], meta["fl_y"]
    else:
        fl_x = fl_y = 0.5 * w / math.tan(0.5 * meta["camera_angle_x"])
    cx, cy = meta.get("cx", w / 2), meta.get("cy", h / 2)
    return Camera(width, height, fl_x * x, fl_y * y, cx * x, cy * y, (k1, k2, p1, p2))
