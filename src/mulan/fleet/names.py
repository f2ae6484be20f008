"""Names of missions and robots, and the Zenoh keys made of them."""

import re
from dataclasses import dataclass

from mulan.errors import InputError
from mulan.mission.bag_writer import ROBOT_NAME
from mulan.mission.messages import HELD_OUT

LONGEST_NAME_BYTES = 32
BASE = "base"  # the base station's place in the key space; no robot may have this name
_MISSION_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]*")


@dataclass(frozen=True)
class RobotKey:
    """The key of a message from a robot.

    Attributes:
        mission: Name of the mission.
        robot: Whose message it is.
        suffix: What follows ``/<robot>/`` in the bag's topic.
    """

    mission: str
    robot: str
    suffix: str

    def __str__(self) -> str:
        return f"mulan/{self.mission}/{self.robot}/{self.suffix}"


def parse_robot_key(key: str) -> RobotKey | None:
    """The parts of a key; None where it is not one of a robot's message."""
    root, _, rest = key.partition("/")
    mission, _, rest = rest.partition("/")
    robot, _, suffix = rest.partition("/")
    if root != "mulan" or not suffix or not is_mission_name(mission) or not is_robot_name(robot):
        return None
    return RobotKey(mission, robot, suffix)


def acknowledgement_key(mission: str, robot: str) -> str:
    """Where the base station answers a robot."""
    return f"mulan/{mission}/{BASE}/{robot}/acknowledgement"


def order_key(mission: str, robot: str, suffix: str) -> str:
    """Where the base station tells a robot something that has a topic of its own in the bag."""
    return f"mulan/{mission}/{BASE}/{robot}/{suffix}"


def is_robot_name(name: str) -> bool:
    """Whether a robot may have this name: a ROS name of at most 32 letters that means nothing else."""
    return (
        len(name) <= LONGEST_NAME_BYTES
        and ROBOT_NAME.fullmatch(name) is not None
        and name not in (HELD_OUT, BASE)
    )


def is_mission_name(name: str) -> bool:
    """Whether a mission may have this name."""
    return len(name) <= LONGEST_NAME_BYTES and _MISSION_NAME.fullmatch(name) is not None


def check_robot_name(name: str, source: str) -> None:
    """See that a robot may have this name.

    Raises:
        InputError: It may not.
    """
    if not is_robot_name(name):
        remedy = f"use at most {LONGEST_NAME_BYTES} letters, digits and underscores"
        raise InputError(source, f"robot name '{name}'", "cannot be a topic's first part", remedy)


def check_mission_name(name: str, source: str) -> None:
    """See that a mission may have this name.

    Raises:
        InputError: It may not.
    """
    if not is_mission_name(name):
        remedy = f"use at most {LONGEST_NAME_BYTES} letters, digits, hyphens and underscores"
        raise InputError(source, f"mission name '{name}'", "cannot be part of a key", remedy)
