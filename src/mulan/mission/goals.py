"""Where robots should go, as the messages that navigation stacks take."""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.geometry import se3
from mulan.mission.messages import GOAL
from mulan.mission.ros_poses import to_pose

PoseStamped = ros.geometry_msgs__msg__PoseStamped

# x forward along the view, y left, z up (REP-103), from the camera's OpenGL axes
_T_FORWARD_CAMERA = np.array(
    [[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def goal_message(T_world_camera: Float[NDArray, "4 4"], world_frame: str) -> PoseStamped:
    """The pose to reach: the camera's place, x forward along its view, y left, z up.

    Its stamp is zero, which tf reads as "the latest transform".

    Args:
        T_world_camera: Camera pose (OpenGL axes).
        world_frame: tf frame of the world.
    """
    header = ros.std_msgs__msg__Header(ros.builtin_interfaces__msg__Time(0, 0), world_frame)
    return PoseStamped(header, to_pose(T_world_camera @ se3.inverse(_T_FORWARD_CAMERA)))


def goals_as_json(goals: dict[str, Float[NDArray, "4 4"]], world_frame: str) -> dict[str, Any]:
    """One ``geometry_msgs/PoseStamped`` a topic, by field names; ``ros2 topic pub`` takes each as it is.

    Args:
        goals: Camera poses (OpenGL axes) by robot name.
        world_frame: tf frame of the world.
    """
    return {GOAL.of(name): _as_json(goal_message(T, world_frame)) for name, T in goals.items()}


def _as_json(goal: PoseStamped) -> dict[str, Any]:
    position, turn = goal.pose.position, goal.pose.orientation
    return {
        "header": {
            "stamp": {"sec": goal.header.stamp.sec, "nanosec": goal.header.stamp.nanosec},
            "frame_id": goal.header.frame_id,
        },
        "pose": {
            "position": {"x": position.x, "y": position.y, "z": position.z},
            "orientation": {"x": turn.x, "y": turn.y, "z": turn.z, "w": turn.w},
        },
    }
