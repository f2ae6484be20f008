"""A mission in a rendered world: robots circle a room and photograph its middle, each its own sector."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import mitsuba as mi
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from PIL import Image

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import HeldOutViews, Mission, Photo
from mulan.simulation.recording import (
    CameraTour,
    SensorConfig,
    plan_camera_tours,
    record_mission,
    robot_names,
)
from mulan.simulation.scene import SceneConfig, build_scene, load_scene_file, render_view
from mulan.simulation.timeline import TourConfig

Progress = Callable[[int, int, str], None]
"""Called with photographs done, photographs in all, and what is being photographed."""

_JPEG_QUALITY = 95
_SECTOR_OVERLAP = 1.4  # each robot sees 40 % more than its share of the circle
_HELD_OUT_SAMPLES = 2  # test views are measured against, so they get more samples


@dataclass(frozen=True)
class SceneMissionConfig:
    """Robots that photograph a rendered scene."""

    robots: int = 3
    """Number of robots."""
    photos_per_robot: int = 32
    """Photographs of each robot."""
    held_out: int = 12
    """Test views with true poses, between the robots' paths."""
    width: int = 192
    """Image width in pixels."""
    height: int = 144
    """Image height in pixels."""
    field_of_view_deg: float = 62.0
    """Horizontal field of view."""
    samples_per_pixel: int = 48
    """Light paths a pixel; twice as many for test views."""
    scene_file: Path | None = None
    """A Mitsuba XML scene (z up, metres) instead of the built-in one, its subject at the origin; the radio
    keeps the walls of the built-in room."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """The built-in room; its walls reflect the radio too."""
    radius_m: tuple[float, float] = (1.6, 2.4)
    """Nearest and farthest distance from the middle."""
    camera_height_m: tuple[float, float] = (0.5, 1.5)
    """Lowest and highest camera."""
    target_height_m: float = 0.5
    """Height that cameras look at."""
    seed: int = 0
    """Source of all randomness."""
    tour: TourConfig = field(default_factory=lambda: TourConfig(rounds=6))
    """Pace."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """Noise."""


def simulate_from_scene(config: SceneMissionConfig, progress: Progress | None = None) -> Mission:
    """Robots that fly curved paths around the middle of a scene and record everything on the way.

    Args:
        config: What to simulate.
        progress: Told after each photograph.

    Raises:
        InputError: Too few robots or photographs, or the scene file cannot be used.
    """
    names = robot_names(config.robots, "SceneMissionConfig")
    if config.photos_per_robot < 2:
        raise InputError("options", "photos_per_robot", "must be at least 2", "ask for more photographs")
    scene = build_scene(config.scene) if config.scene_file is None else load_scene_file(config.scene_file)
    fx = config.width / 2 / np.tan(np.deg2rad(config.field_of_view_deg) / 2)
    camera = PinholeCamera(config.width, config.height, fx, fx, config.width / 2, config.height / 2)
    total = config.robots * config.photos_per_robot + config.held_out
    done = 0

    def photograph(
        T_world_camera: Float[NDArray, "n 4 4"], samples_per_pixel: int, what: str
    ) -> tuple[bytes, ...]:
        nonlocal done
        files = []
        for T in T_world_camera:
            files.append(_jpeg(scene, camera, T, samples_per_pixel, config.seed * 100_003 + done))
            done += 1
            if progress is not None:
                progress(done, total, what)
        return tuple(files)

    tours = []
    for index, name in enumerate(names):
        T = robot_cameras(config, index)
        tours.append(CameraTour(camera, T, "jpeg", photograph(T, config.samples_per_pixel, name)))
    held_out = None
    if config.held_out > 0:
        T = held_out_cameras(config)
        files = photograph(T, _HELD_OUT_SAMPLES * config.samples_per_pixel, "held-out views")
        held_out = HeldOutViews(
            camera, tuple(Photo(float(k), "jpeg", data) for k, data in enumerate(files)), T
        )
    motions = plan_camera_tours(tours, config.tour)
    return record_mission(tours, motions, config.scene.room, config.sensors, held_out, config.seed)


def _jpeg(scene: mi.Scene, camera: PinholeCamera, T: Float[NDArray, "4 4"], samples: int, seed: int) -> bytes:
    buffer = io.BytesIO()
    picture = Image.fromarray(render_view(scene, camera, T, samples, seed))
    picture.save(buffer, format="JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return buffer.getvalue()


def look_at(eye_m: Float[NDArray, "n 3"], target_m: Float[NDArray, "n 3"]) -> Float[NDArray, "n 4 4"]:
    """Upright camera poses (OpenGL axes, world z up) from eye points towards targets."""
    back = eye_m - target_m
    back = back / np.linalg.norm(back, axis=1, keepdims=True)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right, axis=1, keepdims=True)
    return se3.from_parts(np.stack([right, np.cross(back, right), back], -1), eye_m)


def robot_cameras(config: SceneMissionConfig, index: int) -> Float[NDArray, "n 4 4"]:
    """Camera poses of one robot: a wavy arc over its sector, looking at the middle with some sway."""
    rng = np.random.default_rng([config.seed, 4, index])
    sector_rad = min(2 * np.pi / config.robots * _SECTOR_OVERLAP, 2 * np.pi)
    s = np.linspace(0.0, 1.0, config.photos_per_robot)
    azimuth_rad = 2 * np.pi * index / config.robots + (s - 0.5) * sector_rad
    waves = 2 * np.pi * (s[:, None] * np.array([1.7, 2.6]) + rng.random(2))
    eye = _shell_point(config, azimuth_rad, *(0.5 + 0.5 * np.sin(waves)).T)
    sway = 2 * np.pi * (s[:, None] * np.array([2.3, 3.1, 2.7]) + rng.random(3))
    target = np.array([0.0, 0.0, config.target_height_m]) + [0.2, 0.2, 0.12] * np.sin(sway)
    return look_at(eye, target)


def held_out_cameras(config: SceneMissionConfig) -> Float[NDArray, "n 4 4"]:
    """Test poses all around, within the heights and distances the robots keep."""
    rng = np.random.default_rng([config.seed, 5])
    n = config.held_out
    azimuth_rad = 2 * np.pi * (np.arange(n) + rng.uniform(0.2, 0.8, n)) / n
    eye = _shell_point(config, azimuth_rad, rng.uniform(0.15, 0.85, n), rng.uniform(0.15, 0.85, n))
    target = np.array([0.0, 0.0, config.target_height_m]) + rng.uniform(-0.12, 0.12, (n, 3))
    return look_at(eye, target)


def _shell_point(
    config: SceneMissionConfig,
    azimuth_rad: Float[NDArray, "n"],
    outward: Float[NDArray, "n"],
    upward: Float[NDArray, "n"],
) -> Float[NDArray, "n 3"]:
    """Points between the nearest and farthest (0..1 outward), lowest and highest (0..1 upward)."""
    radius = config.radius_m[0] + outward * (config.radius_m[1] - config.radius_m[0])
    height = config.camera_height_m[0] + upward * (config.camera_height_m[1] - config.camera_height_m[0])
    return np.stack([radius * np.cos(azimuth_rad), radius * np.sin(azimuth_rad), height], -1)
