"""The built-in worlds and a user's own: a scene, where robots go in it, and what reflects their radio."""

from dataclasses import dataclass
from pathlib import Path

import mitsuba as mi
import numpy as np

from mulan.simulation.course import Course, RingCourse, WayCourse
from mulan.simulation.image_sources import RoomConfig
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
        walls: What reflects the radio, or None for free space. In the corridor it is the box about it: the
            radio does not know the inner walls.
    """

    scene: mi.Scene
    course: Course
    walls: RoomConfig | None


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
            return World(build_scene(config), course, config.room)
        case WorldKind.TABLETOP:
            return World(build_room(config, tabletop, rng), course, config.room)
        case WorldKind.CORRIDOR:
            walls = RoomConfig((-5.0, -3.5, 0.0), (5.0, 3.5, HEIGHT_M))
            return World(assemble(corridor(rng), config.max_depth), course, walls)
        case WorldKind.YARD:
            return World(assemble(yard(rng), config.max_depth), course, None)


def world_of_file(path: Path, course: Course, walls: RoomConfig | None) -> World:
    """A user's Mitsuba scene (z up, metres).

    Raises:
        InputError: The file is missing or Mitsuba cannot make a scene of it.
    """
    return World(load_scene_file(path), course, walls)
