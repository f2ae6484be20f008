"""A camera path through a field as MP4: colour, depth, variance."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from matplotlib import colormaps
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.export.camera_path import CameraView, camera_path
from mulan.export.extras import extra_module
from mulan.mission.pixels import resized_shape
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import write_atomically
from mulan.radiance.engine import RadianceEngine, Rendering
from mulan.reconstruction.sub_pixels import render_pixels

_PIXELS_AT_ONCE = 32768  # rendered at once, so that memory does not grow with the picture
_PROBES, _PROBE_SIDE = 8, 64  # small pictures that settle the range of depth and variance for all frames


@dataclass(frozen=True)
class VideoConfig:
    """A camera path as MP4 (H.264)."""

    path: Literal["orbit", "robots"] = "orbit"
    """Around the scene, or along the robots' own ways, one after another."""
    frames: int = 120
    """Pictures."""
    frames_per_s: float = 24.0
    """Pictures a second."""
    image_size: int = 480
    """Longest side in pixels."""
    smoothing: float = 1.5
    """Smoothing of the robots' ways, in photographs."""
    shows: tuple[Literal["colour", "depth", "variance"], ...] = ("colour",)
    """One file each: the picture, the distance (near is bright), the predicted doubt (much is bright)."""


@dataclass(frozen=True)
class _Range:
    low: float
    high: float

    def of(self, values: Float[NDArray, "*n"]) -> Float[NDArray, "*n"]:
        return np.clip((values - self.low) / max(self.high - self.low, 1e-12), 0, 1)


def export_video(
    engine: RadianceEngine,
    images: PosedImageSet,
    config: VideoConfig,
    sub_pixels: int,
    folder: Path,
    progress: Callable[[float, float, str], None],
) -> list[Path]:
    """Write ``video.mp4`` (and ``video_depth.mp4``, ``video_variance.mp4``), picture by picture.

    Args:
        engine: The field.
        images: Photographs; they give the path and the lens.
        config: How.
        sub_pixels: Rays a side of a pixel.
        folder: Target.
        progress: Called with what is done.

    Raises:
        InputError: imageio-ffmpeg is missing, an option cannot be used, or a file cannot be written.
    """
    ffmpeg = extra_module("imageio_ffmpeg", "imageio-ffmpeg", "--to video")
    for name, value in (("frames", config.frames), ("image_size", config.image_size - 15)):
        if value < 1:
            raise InputError("--video", name, "is too small", "give at least one frame of 16 pixels")
    if not 0 < config.frames_per_s <= 1000 or config.smoothing < 0 or not config.shows:
        raise InputError(
            "--video", "options", "ask for no video", "give frames-per-s above 0, smoothing from 0, one view"
        )
    views = camera_path(images, config.path, config.frames, config.smoothing)
    ranges = _ranges(engine, views)
    paths = {shown: _file(folder, shown) for shown in dict.fromkeys(config.shows)}
    camera = views[0][0]
    # the codec halves the resolution of colour, so sides must be even
    width, height = (
        max(2, side // 2 * 2) for side in resized_shape(camera.width, camera.height, config.image_size)
    )

    def write(targets: dict[str, Path]) -> None:
        with ExitStack() as stack:
            encoders = {
                shown: stack.enter_context(_encoder(ffmpeg, target, (width, height), config.frames_per_s))
                for shown, target in targets.items()
            }
            for number, view in enumerate(views):
                progress(number, len(views), "")
                rendering = _rendering(engine, view, width, height, sub_pixels)
                for shown, encoder in encoders.items():
                    encoder.send(_picture(rendering, shown, ranges).reshape(height, width, 3).tobytes())

    _write_all(list(paths.items()), {}, write)
    progress(1, 1, "")
    return list(paths.values())


def _file(folder: Path, shown: str) -> Path:
    return folder / ("video.mp4" if shown == "colour" else f"video_{shown}.mp4")


def _write_all(
    left: list[tuple[str, Path]], temporaries: dict[str, Path], write: Callable[[dict[str, Path]], None]
) -> None:
    """All files at once, each renamed only when every one is complete."""
    if not left:
        write(temporaries)
        return
    (shown, path), *rest = left
    write_atomically(path, lambda temporary: _write_all(rest, temporaries | {shown: temporary}, write))


@contextmanager
def _encoder(ffmpeg: ModuleType, path: Path, size: tuple[int, int], frames_per_s: float) -> Iterator[Any]:
    encoder = ffmpeg.write_frames(
        str(path), size, fps=frames_per_s, quality=8, macro_block_size=2, ffmpeg_log_level="error"
    )
    encoder.send(None)
    try:
        yield encoder
    finally:
        encoder.close()


def _rendering(
    engine: RadianceEngine, view: CameraView, width: int, height: int, sub_pixels: int
) -> Rendering:
    camera, T = view[0].resized(width, height), torch.from_numpy(view[1].astype(np.float32))
    directions = torch.from_numpy(camera.pixel_directions().reshape(-1, 3).astype(np.float32)) @ T[:3, :3].T
    focal_px = torch.tensor([camera.fx, camera.fy])
    parts = [
        render_pixels(
            engine,
            T[:3, 3].expand(len(d), 3).contiguous(),
            d,
            T[:3, :3].expand(len(d), 3, 3),
            focal_px.expand(len(d), 2),
            sub_pixels,
        )
        for d in directions.split(_PIXELS_AT_ONCE)
    ]
    names = ("colour", "depth_m", "opacity", "variance")
    return Rendering(*(torch.cat([getattr(part, name) for part in parts]).cpu() for name in names))


def _ranges(engine: RadianceEngine, views: Sequence[CameraView]) -> dict[str, _Range]:
    chosen = np.linspace(0, len(views) - 1, min(_PROBES, len(views))).round().astype(int)
    camera = views[0][0]
    width, height = resized_shape(camera.width, camera.height, _PROBE_SIDE)
    probes = [_rendering(engine, views[int(i)], width, height, 1) for i in chosen]
    depth_m = np.concatenate([probe.depth_m[probe.opacity > 0.5].numpy() for probe in probes])
    variance = np.concatenate([probe.variance.numpy() for probe in probes])
    near, far = np.quantile(depth_m, [0.02, 0.98]) if len(depth_m) else (0.0, 1.0)
    return {
        "depth": _Range(float(near), float(far)),
        "variance": _Range(0.0, float(np.quantile(np.sqrt(variance), 0.98))),
    }


def _picture(rendering: Rendering, shown: str, ranges: dict[str, _Range]) -> UInt8[NDArray, "p 3"]:
    if shown == "colour":
        rgb = rendering.colour.numpy()
    elif shown == "depth":
        bright = 1 - 0.85 * ranges["depth"].of(rendering.depth_m.numpy())
        rgb = np.repeat(np.where(rendering.opacity.numpy() > 0.5, bright, 0.0)[:, None], 3, axis=1)
    else:
        spread = ranges["variance"].of(np.sqrt(rendering.variance.numpy()))
        rgb = colormaps["inferno"](spread)[:, :3]
    return (np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
