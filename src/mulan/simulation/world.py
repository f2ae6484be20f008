"""The built-in worlds and a user's own: a scene, where robots go in it, and what reflects their radio."""

from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from mulan.simulation.course import Course, RingCourse, WayCourse
from mulan.simulation.image_sources import RoomConfig
from mulan.simulation.propagation import Mirrors, Propagation
from mulan.simulation.scene import SceneConfig, assemble, build_room, build_scene, load_scene_file
from mulan.simulation.scene_corridor import HEIGHT_M, MIDDLE_M, corridor
from mulan.simulation.scene_tabletop import TOP_HEIGHT_M, tabletop
from mulan.simulation.scene_yard import yard
from mulan.simulation.world_kind import WorldKind

ROOM_COURSE = RingCourse(radius_m=(1.6, 2.4), height_m=(0.5, 1.5), target_height_m=0.5)
_COURSES: dict[WorldKind, Course] = {
    WorldKind.TABLETOP: RingCourse((1.0, 1.5), (1.0, 1.6), TOP_HEIGHT_M + 0.1),
    WorldKind.ROOM: ROOM_COURSE,
    WorldKind.CORRIDOR: WayCourse(MIDDLE_M, 0.25, (0.9, 1.5), 1.8, 1.1),
    WorldKind.YARD: RingCourse((2.2, 3.2), (0.6, 1.7), 0.6),
}


@dataclass(frozen=True)
class World:
    """What is there.

    Attributes:
        scene: What is photographed, and what robots would run into.
        course: Where cameras go.
        propagation: What carries the radio. The built-in one knows the walls of the room and of the table's
            room, free space in the yard, and the box about the corridor without its inner walls.
    """

    scene: mi.Scene
    course: Course
    propagation: Propagation


def course_of(kind: WorldKind) -> Course:
    """Where cameras go in a built-in world."""
    return _COURSES[kind]


def build_world(kind: WorldKind, config: SceneConfig) -> World:
    """One of the built-in worlds (z up, metres).

    Args:
        kind: Which.
        config: Walls and lamps of the room and the table; seed and path length of all.
    """
    course, rng = _COURSES[kind], np.random.default_rng(config.seed)
    match kind:
        case WorldKind.ROOM:
            return World(build_scene(config), course, Mirrors(config.room))
        case WorldKind.TABLETOP:
            return World(build_room(config, tabletop, rng), course, Mirrors(config.room))
        case WorldKind.CORRIDOR:
            walls = RoomConfig((-5.0, -3.5, 0.0), (5.0, 3.5, HEIGHT_M))
            return World(assemble(corridor(rng), config), course, Mirrors(walls))
        case WorldKind.YARD:
            return World(assemble(yard(rng), config), course, Mirrors(None))


def world_of_file(path: Path, course: Course, config: SceneConfig) -> World:
    """A user's Mitsuba scene (z up, metres).

    Args:
        path: The XML file.
        course: Where cameras go.
        config: Whose walls the built-in radio keeps.

    Raises:
        InputError: The file is missing or Mitsuba cannot make a scene of it.
    """
    return World(load_scene_file(path, config.merge_meshes), course, Mirrors(config.room))
