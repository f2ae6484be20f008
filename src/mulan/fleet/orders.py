"""Poses, goals and requests as ROS messages, from the run folder a learner writes to the robots."""

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.errors import InputError
from mulan.fleet.base_station import BaseStation
from mulan.fleet.live_state import LiveRobot, LiveState, read_state, state_file
from mulan.mission import messages, ros_poses
from mulan.mission.messages import RobotFrames
from mulan.mission.ros_stamps import to_nanoseconds, to_stamp
from mulan.mission.run_folder import RunFolder, read_json

_LOOK_EVERY_S = 0.5


def pose_message(robot: LiveRobot) -> Any:
    """Where a robot is in the world, stamped by its own clock, with ROS's covariance."""
    header = ros.std_msgs__msg__Header(to_stamp(to_nanoseconds(robot.time_s)), "world")
    covariance = ros_poses.covariance_to_ros(robot.T_world_body, robot.covariance)
    pose = ros.geometry_msgs__msg__PoseWithCovariance(
        ros_poses.to_pose(robot.T_world_body), covariance.reshape(36)
    )
    return ros.geometry_msgs__msg__PoseWithCovarianceStamped(header, pose)


def goal_message(name: str, T_odom_body: Float[NDArray, "4 4"], chosen_ns: int) -> Any:
    """Where a robot's body should go, in its own odometry frame; the stamp tells one goal from another."""
    header = ros.std_msgs__msg__Header(to_stamp(chosen_ns), RobotFrames(name).odom)
    return ros.geometry_msgs__msg__PoseStamped(header, ros_poses.to_pose(T_odom_body))


def request_message(name: str, peers: Sequence[str], asked_ns: int) -> Any:
    """That a robot should move its antenna while these answer; the stamp tells one request from another."""
    header = ros.std_msgs__msg__Header(to_stamp(asked_ns), RobotFrames(name).odom)
    return messages.typestore().types[messages.REQUEST.msgtype](header, list(peers))


def goal_of(message: Any) -> Float[NDArray, "4 4"]:
    """The body pose a goal message asks for.

    Raises:
        ValueError: It is not finite or not a rotation.
    """
    p, q = message.pose.position, message.pose.orientation
    return ros_poses.to_matrices(np.array([[p.x, p.y, p.z]]), np.array([[q.x, q.y, q.z, q.w]]))[0]


class Orders:
    """Passes on what a learner, or a person at the page, writes to a run folder.

    A goal picked by hand (``goals.json``) takes the place of a planned one until the next round of planning.
    """

    def __init__(
        self, base: BaseStation, run: RunFolder, tell: Callable[[str], object] = lambda _: None
    ) -> None:
        """Begin to watch the folder, in a thread of its own."""
        self._base, self._run, self._tell = base, run, tell
        self._picked_file = run.root / "goals.json"
        self._seen = {path: _stamp(path) for path in (state_file(run), self._picked_file)}
        self._goals: dict[str, bytes] = {}
        self._requests: dict[str, tuple[float, tuple[str, ...]]] = {}
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="orders", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Watch no more."""
        self._closing.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._closing.wait(_LOOK_EVERY_S):
            try:
                if self._changed(state_file(self._run)):
                    self._send(read_state(self._run))
                if self._changed(self._picked_file):
                    self._send_picked(read_state(self._run))
            except InputError as error:
                self._tell(f"goals: {error}")

    def _changed(self, path: Path) -> bool:
        stamp = _stamp(path)
        if stamp is None or stamp == self._seen[path]:
            return False
        self._seen[path] = stamp
        return True

    def _send(self, state: LiveState) -> None:
        for name, robot in state.robots.items():
            self._base.order(name, messages.POSE, pose_message(robot))
            if robot.T_world_camera_goal is not None:
                self._order(name, robot, robot.T_world_camera_goal, state.planned_ns)
            self._request(name, robot)

    def _request(self, name: str, robot: LiveRobot) -> None:
        """Once for each pose found anew: planning writes the state again without new poses."""
        if robot.measure_with is None or self._requests.get(name) == (robot.time_s, robot.measure_with):
            return
        self._requests[name] = robot.time_s, robot.measure_with
        message = request_message(name, robot.measure_with, time.time_ns())
        self._base.order(name, messages.REQUEST, message)

    def _send_picked(self, state: LiveState) -> None:
        for name, entry in read_json(self._picked_file, "mulan view").items():
            if name not in state.robots:
                self._tell(f"{name}: has no place yet, so it cannot be told where to go")
                continue
            try:
                T_world_camera = np.array(entry["T_world_camera"], dtype=float).reshape(4, 4)
            except (KeyError, TypeError, ValueError):
                remedy = "delete it and pick the goal again"
                raise InputError(self._picked_file, name, "is no camera pose", remedy) from None
            self._order(name, state.robots[name], T_world_camera, time.time_ns())

    def _order(self, name: str, robot: LiveRobot, T_world_camera: Float[NDArray, "4 4"], at_ns: int) -> None:
        goal = T_world_camera.tobytes()
        if self._goals.get(name) == goal:
            return  # the same as before: localized a little better, which is not worth a new way
        self._goals[name] = goal
        self._base.order(
            name, messages.GOAL, goal_message(name, robot.T_odom_body_goal(T_world_camera), at_ns)
        )


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_ino
