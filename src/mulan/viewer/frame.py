"""One picture of the page's camera: what the field shows there, and how far away it is."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, UInt8
from matplotlib import colormaps
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera
from mulan.radiance.engine import RadianceEngine, Rendering

Quantity = Literal["colour", "depth", "uncertainty"]
_LEAST_OPACITY = 0.5  # of a pixel that hides what lies behind it
_FAR_M = 1e4
_BAND_RAYS = 40_000  # rendered before a picture may be abandoned: a moving one is whole
_WHOLE_RANGE = (2.0, 98.0)  # percentiles that get the first and the last colour


class AbandonedError(Exception):
    """A picture was given up half done."""


@dataclass(frozen=True)
class Frame:
    """A rendered picture.

    Attributes:
        picture: sRGB.
        depth_m: Distance along the viewing axis, for hiding what lies behind; far where nothing is seen.
        legend: What the colours mean, in words; empty for photographs.
    """

    picture: UInt8[NDArray, "h w 3"]
    depth_m: Float[NDArray, "h w"]
    legend: str


def pinhole(width: int, height: int, vertical_fov_rad: float) -> PinholeCamera:
    """A camera without distortion that sees a vertical angle."""
    f = height / (2 * np.tan(vertical_fov_rad / 2))
    return PinholeCamera(width, height, f, f, width / 2, height / 2)


def render_frame(
    engine: RadianceEngine,
    camera: PinholeCamera,
    T_world_camera: Float[NDArray, "4 4"],
    quantity: Quantity,
    preview: bool = False,
    still_wanted: Callable[[], bool] = lambda: True,
) -> Frame:
    """Render the field from a pose (OpenGL axes).

    Args:
        engine: The field.
        camera: Lens and size of the picture.
        T_world_camera: Camera pose.
        quantity: What the picture shows: colour, depth, or the standard deviation of the colour.
        preview: Whether what is nearly clear may be left out, to be faster.
        still_wanted: Asked now and then.

    Raises:
        AbandonedError: The picture was no longer wanted.
    """
    shape = camera.height, camera.width
    local = camera.pixel_directions().reshape(-1, 3)
    directions = torch.from_numpy((local @ T_world_camera[:3, :3].T).astype(np.float32))
    origins = torch.from_numpy(T_world_camera[:3, 3].astype(np.float32)).expand(len(directions), 3)
    render, bands = engine.preview if preview else engine.render, []
    for band in zip(origins.contiguous().split(_BAND_RAYS), directions.split(_BAND_RAYS), strict=True):
        if not still_wanted():
            raise AbandonedError
        bands.append(render(*band))
    rendering = Rendering(
        **{f.name: torch.cat([getattr(b, f.name) for b in bands]) for f in fields(Rendering)}
    )
    opacity = rendering.opacity.cpu().numpy()
    distance_m = rendering.depth_m.cpu().numpy()
    depth_m = np.where(opacity > _LEAST_OPACITY, distance_m * -local[:, 2], _FAR_M)
    picture, legend = _picture(rendering, depth_m, quantity)
    return Frame(picture.reshape(*shape, 3), depth_m.reshape(shape).astype(np.float32), legend)


def _picture(
    rendering: Rendering, depth_m: Float[NDArray, "r"], quantity: Quantity
) -> tuple[UInt8[NDArray, "r 3"], str]:
    if quantity == "colour":
        return (np.clip(rendering.colour.cpu().numpy(), 0, 1) * 255 + 0.5).astype(np.uint8), ""
    if quantity == "depth":
        seen = depth_m < _FAR_M
        return _false_colours(depth_m, seen, "viridis_r", "m", "near is bright")
    sigma = np.sqrt(np.clip(rendering.variance.cpu().numpy(), 0, None))
    return _false_colours(sigma, np.ones(len(sigma), bool), "magma", "of full scale", "unsure is bright")


def _false_colours(
    values: Float[NDArray, "r"], shown: NDArray[np.bool_], colours: str, unit: str, words: str
) -> tuple[UInt8[NDArray, "r 3"], str]:
    picture = np.full((len(values), 3), 255, np.uint8)
    if not shown.any():
        return picture, "nothing is seen from here"
    low, high = np.percentile(values[shown], _WHOLE_RANGE)
    share = np.clip((values[shown] - low) / max(high - low, 1e-9), 0, 1)
    picture[shown] = (colormaps[colours](share)[:, :3] * 255).astype(np.uint8)
    return picture, f"{words}; {low:.3g} to {high:.3g} {unit}"
