"""What the base station's learner knows of every robot, and where it wants each to go."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.mission.run_folder import RunFolder, read_json, write_json

_FILE = "live.json"


@dataclass(frozen=True)
class LiveRobot:
    """One placed robot.

    Attributes:
        time_s: Instant of the pose, on the robot's clock: its last photograph.
        T_world_body: Where it was, in the anchor's start frame.
        covariance: Of that pose (right perturbation; rotation rad, translation m).
        T_world_odom: Its odometry frame in the world, as it stood at that instant.
        T_body_camera: Its camera (OpenGL axes).
        T_world_camera_goal: Where its camera should go next; None where it may do as it likes.
        measure_with: Whose answers its next antenna motion should hear; empty where none is needed, None
            where that was not judged.
    """

    time_s: float
    T_world_body: Float[NDArray, "4 4"]
    covariance: Float[NDArray, "6 6"]
    T_world_odom: Float[NDArray, "4 4"]
    T_body_camera: Float[NDArray, "4 4"]
    T_world_camera_goal: Float[NDArray, "4 4"] | None = None
    measure_with: tuple[str, ...] | None = None

    def T_odom_body_goal(self, T_world_camera: Float[NDArray, "4 4"]) -> Float[NDArray, "4 4"]:
        """A camera goal as the robot understands it: its body's pose in its own odometry frame."""
        T_world_body = T_world_camera @ se3.inverse(self.T_body_camera)
        return se3.inverse(self.T_world_odom) @ T_world_body


@dataclass(frozen=True)
class LiveState:
    """Everything after one round of localization, learning and planning.

    Attributes:
        planned_ns: When the goals were chosen, on the base station's clock.
        robots: Placed robots by name, the anchor first.
    """

    planned_ns: int
    robots: Mapping[str, LiveRobot]


def state_file(run: RunFolder) -> Path:
    """Where a run's state lies."""
    return run.root / _FILE


def write_state(state: LiveState, run: RunFolder) -> None:
    """Write ``live.json``.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    robots = {
        name: {
            "time_s": robot.time_s,
            "T_world_body": robot.T_world_body.tolist(),
            "covariance": robot.covariance.tolist(),
            "T_world_odom": robot.T_world_odom.tolist(),
            "T_body_camera": robot.T_body_camera.tolist(),
            "T_world_camera_goal": None
            if robot.T_world_camera_goal is None
            else robot.T_world_camera_goal.tolist(),
            "measure_with": robot.measure_with,
        }
        for name, robot in state.robots.items()
    }
    write_json(state_file(run), {"planned_ns": state.planned_ns, "robots": robots})


def read_state(run: RunFolder) -> LiveState:
    """Read ``live.json``.

    Raises:
        InputError: It is missing, or not one a learner wrote.
    """
    path = state_file(run)
    record = read_json(path, "mulan fleet learn")
    try:
        robots = {name: _robot(entry) for name, entry in record["robots"].items()}
        return LiveState(int(record["planned_ns"]), robots)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        problem, remedy = f"is not a learner's ({error})", "delete it; the learner writes it again"
        raise InputError(path, "contents", problem, remedy) from error


def _robot(entry: Mapping[str, Any]) -> LiveRobot:
    goal, peers = entry["T_world_camera_goal"], entry.get("measure_with")
    return LiveRobot(
        float(entry["time_s"]),
        np.array(entry["T_world_body"], dtype=float).reshape(4, 4),
        np.array(entry["covariance"], dtype=float).reshape(6, 6),
        np.array(entry["T_world_odom"], dtype=float).reshape(4, 4),
        np.array(entry["T_body_camera"], dtype=float).reshape(4, 4),
        None if goal is None else np.array(goal, dtype=float).reshape(4, 4),
        None if peers is None else tuple(str(peer) for peer in peers),
    )
