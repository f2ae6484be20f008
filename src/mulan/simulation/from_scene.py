"""A mission in a rendered world: robots tour its course and photograph, each its own share."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import mitsuba as mi
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from PIL import Image

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import HeldOutViews, Mission, Photo
from mulan.simulation.course import Course, RingCourse
from mulan.simulation.radio_kind import RadioKind
from mulan.simulation.radio_surfaces import radio_surfaces
from mulan.simulation.recording import (
    CameraTour,
    SensorConfig,
    plan_camera_tours,
    record_mission,
    robot_names,
)
from mulan.simulation.scene import SceneConfig, render_view
from mulan.simulation.sionna_config import SionnaConfig
from mulan.simulation.sionna_radio import SionnaRadio
from mulan.simulation.timeline import TourConfig
from mulan.simulation.world import ROOM_COURSE, World, build_world, course_of, world_of_file
from mulan.simulation.world_kind import WorldKind

Progress = Callable[[int, int, str], None]
"""Called with photographs done, photographs in all, and what is being photographed."""

_JPEG_QUALITY = 95
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
    world: WorldKind = WorldKind.ROOM
    """Which built-in world."""
    scene_file: Path | None = None
    """A Mitsuba XML scene (z up, metres) instead of the built-in ones, its subject at the origin; the
    built-in radio keeps the walls of the built-in room."""
    radio: RadioKind = RadioKind.MIRRORS
    """What carries the radio."""
    sionna: SionnaConfig = field(default_factory=SionnaConfig)
    """How Sionna RT traces rays, if it carries the radio."""
    scene: SceneConfig = field(default_factory=SceneConfig)
    """The built-in room; its walls reflect the radio too."""
    radius_m: tuple[float, float] = ROOM_COURSE.radius_m
    """In the room and in a scene file, nearest and farthest distance from the middle."""
    camera_height_m: tuple[float, float] = ROOM_COURSE.height_m
    """In the room and in a scene file, lowest and highest camera."""
    target_height_m: float = ROOM_COURSE.target_height_m
    """In the room and in a scene file, height that cameras look at."""
    seed: int = 0
    """Source of all randomness."""
    tour: TourConfig = field(default_factory=lambda: TourConfig(rounds=6))
    """Pace."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """Noise."""

    @property
    def camera(self) -> PinholeCamera:
        """The lens of all robots."""
        fx = float(self.width / 2 / np.tan(np.deg2rad(self.field_of_view_deg) / 2))
        return PinholeCamera(self.width, self.height, fx, fx, self.width / 2, self.height / 2)

    @property
    def course(self) -> Course:
        """Where cameras go."""
        if self.scene_file is None and self.world is not WorldKind.ROOM:
            return course_of(self.world)
        return RingCourse(self.radius_m, self.camera_height_m, self.target_height_m)

    def build(self) -> World:
        """The world.

        Raises:
            InputError: The scene file cannot be used, or Sionna RT is missing.
        """
        world = self._world(self.scene)
        if self.radio is RadioKind.MIRRORS:
            return world
        unmerged = self._world(replace(self.scene, merge_meshes=False)).scene
        return replace(world, propagation=SionnaRadio(radio_surfaces(unmerged), self.sionna))

    def _world(self, scene: SceneConfig) -> World:
        if self.scene_file is not None:
            return world_of_file(self.scene_file, self.course, scene)
        return replace(build_world(self.world, scene), course=self.course)


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
    world, camera = config.build(), config.camera
    total = config.robots * config.photos_per_robot + config.held_out
    done = 0

    def photograph(
        T_world_camera: Float[NDArray, "n 4 4"], samples_per_pixel: int, what: str
    ) -> tuple[bytes, ...]:
        nonlocal done
        files = []
        for T in T_world_camera:
            files.append(jpeg(world.scene, camera, T, samples_per_pixel, config.seed * 100_003 + done))
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
    return record_mission(tours, motions, world.propagation, config.sensors, held_out, config.seed)


def jpeg(scene: mi.Scene, camera: PinholeCamera, T: Float[NDArray, "4 4"], samples: int, seed: int) -> bytes:
    """One photograph as a JPEG file; see :func:`mulan.simulation.scene.render_view`."""
    buffer = io.BytesIO()
    picture = Image.fromarray(render_view(scene, camera, T, samples, seed))
    picture.save(buffer, format="JPEG", quality=_JPEG_QUALITY, subsampling=0)
    return buffer.getvalue()


def robot_cameras(config: SceneMissionConfig, index: int) -> Float[NDArray, "n 4 4"]:
    """Camera poses of one robot: wavy, over its share of the course, looking ahead with some sway."""
    rng = np.random.default_rng([config.seed, 4, index])
    s = np.linspace(0.0, 1.0, config.photos_per_robot)
    waves = 2 * np.pi * (s[:, None] * np.array([1.7, 2.6]) + rng.random(2))
    sway = 2 * np.pi * (s[:, None] * np.array([2.3, 3.1, 2.7]) + rng.random(3))
    outward, upward = (0.5 + 0.5 * np.sin(waves)).T
    course = config.course
    along = course.share(index, config.robots, s)
    return course.cameras(along, outward, upward, np.array([0.2, 0.2, 0.12]) * np.sin(sway))


def held_out_cameras(config: SceneMissionConfig) -> Float[NDArray, "n 4 4"]:
    """Test poses all along the course, within the heights and distances the robots keep."""
    rng = np.random.default_rng([config.seed, 5])
    n = config.held_out
    along = (np.arange(n) + rng.uniform(0.2, 0.8, n)) / n
    outward, upward = rng.uniform(0.15, 0.85, n), rng.uniform(0.15, 0.85, n)
    return config.course.cameras(along, outward, upward, rng.uniform(-0.12, 0.12, (n, 3)))
