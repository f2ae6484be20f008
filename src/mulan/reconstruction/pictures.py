"""Rendered views as PNG files and one animation."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from PIL import Image

from mulan.geometry.camera import PinholeCamera
from mulan.mission.pixels import encode_png, resized_shape
from mulan.mission.run_folder import write_atomically
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.sub_pixels import render_pixels

_FRAME_MS = 60


def render_picture(
    engine: RadianceEngine,
    camera: PinholeCamera,
    T_world_camera: Float[NDArray, "4 4"],
    longest_side: int,
    sub_pixels: int = 1,
) -> UInt8[NDArray, "h w 3"]:
    """What a camera at a pose would photograph, at another resolution; see :func:`render_pixels`."""
    width, height = resized_shape(camera.width, camera.height, longest_side)
    camera = camera.resized(width, height)
    pixels, T = width * height, torch.from_numpy(T_world_camera.astype(np.float32))
    directions = torch.from_numpy(camera.pixel_directions().reshape(-1, 3).astype(np.float32)) @ T[:3, :3].T
    lens = T[:3, :3].expand(pixels, 3, 3), torch.tensor([camera.fx, camera.fy]).expand(pixels, 2)
    colour = render_pixels(engine, T[:3, 3].expand(pixels, 3), directions, *lens, sub_pixels).colour
    pixels = colour.cpu().numpy().reshape(height, width, 3)
    return (np.clip(pixels, 0, 1) * 255 + 0.5).astype(np.uint8)


def write_pictures(
    engine: RadianceEngine,
    views: Sequence[tuple[PinholeCamera, Float[NDArray, "4 4"]]],
    longest_side: int,
    folder: Path,
    progress: Callable[[float, float, str], None],
    sub_pixels: int = 1,
) -> Path:
    """Render every view to ``000.png``, ... and all of them to ``animation.webp``; returns the latter."""
    frames = []
    for index, (camera, T) in enumerate(views):
        progress(index, len(views), "")
        frames.append(render_picture(engine, camera, T, longest_side, sub_pixels))
        png = encode_png(frames[-1])
        write_atomically(folder / f"{index:03d}.png", lambda path, png=png: path.write_bytes(png) and None)
    progress(len(views), len(views), "")
    pictures = [Image.fromarray(frame) for frame in frames]
    animation = folder / "animation.webp"
    write_atomically(
        animation,
        lambda path: pictures[0].save(
            path, save_all=True, append_images=pictures[1:], duration=_FRAME_MS, loop=0, quality=85
        ),
    )
    return animation
