"""The rendered world: built by code or loaded from a user's file, photographed through a pinhole camera."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.simulation.image_sources import RoomConfig
from mulan.simulation.mitsuba_parts import Node, panel, place, plain, use_scalar_variant
from mulan.simulation.scene_lights import lamp
from mulan.simulation.scene_room import room
from mulan.simulation.scene_rover import rover

# Mitsuba sensors look along +z with x to the left; ours look along -z with x to the right
_T_CAMERA_MITSUBA = np.diag([-1.0, 1.0, -1.0, 1.0])


@dataclass(frozen=True)
class SceneConfig:
    """The built-in room with a rover in its middle."""

    room: RoomConfig = field(default_factory=RoomConfig)
    """Walls of the room, the same for light and radio; the rover stands in the middle of the floor."""
    skylight_radiance: float = 6.5
    """Soft white light from a panel over half the ceiling's width and depth."""
    lamp_radiance: float = 21.0
    """Warm light from one square metre of the ceiling; gives shadows their direction."""
    max_depth: int = 3
    """Longest light path, in bounces from the camera."""
    seed: int = 7
    """Pattern of boards, bricks and books."""
    merge_meshes: bool = True
    """Make one of all meshes of one surface, for speed; only unmerged ones keep their names."""


def build_scene(config: SceneConfig) -> mi.Scene:
    """The furnished room (world: z up, metres, rover at the origin looking along +x)."""
    return build_room(config, rover, np.random.default_rng(config.seed))


def build_room(
    config: SceneConfig,
    subject: Callable[[np.random.Generator], dict[str, Node]],
    rng: np.random.Generator,
) -> mi.Scene:
    """The furnished room about any subject, which stands in the middle of its floor.

    Args:
        config: Walls and lamps.
        subject: Makes the parts, standing on z = 0 at the origin.
        rng: Source of all patterns.
    """
    low, high = config.room.min_corner_m, config.room.max_corner_m
    size = np.array(high) - np.array(low)
    use_scalar_variant()
    T_room = place(((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]))
    parts = room(float(size[0]), float(size[1]), float(size[2]), rng) | subject(rng)
    parts |= _lights(config, float(size[0]), float(size[1]), float(size[2]))
    for part in parts.values():
        part["to_world"] = mi.ScalarTransform4f(T_room.tolist()) @ part.get(
            "to_world", mi.ScalarTransform4f()
        )
    return assemble(parts, config)


def assemble(parts: dict[str, Node], config: SceneConfig) -> mi.Scene:
    """A scene of parts.

    Args:
        parts: Shapes and emitters by name.
        config: Longest light path, and whether meshes are merged.
    """
    use_scalar_variant()
    integrator = {"type": "path", "max_depth": config.max_depth}
    scene = mi.load_dict({"type": "scene", "integrator": integrator} | parts, optimize=config.merge_meshes)
    assert isinstance(scene, mi.Scene)
    return scene


def _lights(config: SceneConfig, width_m: float, depth_m: float, height_m: float) -> dict[str, Node]:
    ceiling = panel(place((0.0, 0.0, height_m), pitch_deg=180.0), (width_m, depth_m), plain((0.8, 0.8, 0.8)))
    # smaller than the ceiling: fewer wasted samples, less noise
    skylight = lamp((-0.4, 0.0, height_m - 0.01), (width_m / 2, depth_m / 2), config.skylight_radiance)
    warm = lamp((1.2, 0.9, height_m - 0.02), (1.0, 1.0), config.lamp_radiance, (1.0, 0.93, 0.82))
    return {"ceiling": ceiling, "skylight": skylight, "lamp": warm}


def load_scene_file(path: Path, merge_meshes: bool = True) -> mi.Scene:
    """A user's own Mitsuba XML scene (z up, metres).

    Args:
        path: The file.
        merge_meshes: As in :class:`SceneConfig`.

    Raises:
        InputError: The file is missing or Mitsuba cannot make a scene of it.
    """
    use_scalar_variant()
    if not path.is_file():
        raise InputError(path, "scene", "no such file", "name a Mitsuba 3 XML scene")
    try:
        scene = mi.load_file(str(path), optimize=merge_meshes)
    except RuntimeError as error:
        reason = " ".join(str(error).split())
        raise InputError(path, "scene", reason, "correct it until 'mitsuba' itself can render it") from error
    if not isinstance(scene, mi.Scene):
        raise InputError(path, "scene", "its root is not a <scene>", "wrap it in <scene version='3.0.0'>")
    return scene


def render_view(
    scene: mi.Scene,
    camera: PinholeCamera,
    T_world_camera: Float[NDArray, "4 4"],
    samples_per_pixel: int,
    seed: int,
) -> UInt8[NDArray, "h w 3"]:
    """One photograph as 8-bit sRGB.

    Args:
        scene: What to photograph.
        camera: Square pixels, no distortion.
        T_world_camera: Camera pose (OpenGL axes).
        samples_per_pixel: Light paths a pixel, rounded up to fill a grid; noise falls with the square root.
        seed: Of the sampler.

    Raises:
        InputError: The lens is distorted or its pixels are not square.
    """
    use_scalar_variant()
    if any(camera.distortion) or abs(camera.fx - camera.fy) > 1e-6 * camera.fx:
        raise InputError(
            "camera", "intrinsics", "have distortion or fx != fy", "render with an ideal pinhole camera"
        )
    samples = _whole_grid(samples_per_pixel)
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.rad2deg(2 * np.arctan2(camera.width / 2, camera.fx))),
            "principal_point_offset_x": 0.5 - camera.cx / camera.width,
            "principal_point_offset_y": 0.5 - camera.cy / camera.height,
            "near_clip": 0.01,
            "far_clip": 1e4,
            "to_world": mi.ScalarTransform4f((T_world_camera @ _T_CAMERA_MITSUBA).tolist()),
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "pixel_format": "rgb",
                "rfilter": {"type": "gaussian"},
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
    )
    linear = np.array(mi.render(scene, sensor=sensor, spp=samples, seed=mi.UInt32(seed % 2**32)))
    return _srgb_bytes(linear)


def _whole_grid(samples: int) -> int:
    """Least product of two nearly equal integers that is not below a number; what multijitter can place."""
    rows = int(np.sqrt(samples))
    return rows * int(np.ceil(samples / rows))


def _srgb_bytes(linear: Float[NDArray, "h w 3"]) -> UInt8[NDArray, "h w 3"]:
    """IEC 61966-2-1 transfer curve."""
    value = np.clip(linear, 0.0, 1.0)
    curve = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)
