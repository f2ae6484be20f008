"""Poses of any ROS message as the two messages a mission has: odometry and true poses."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.mission.imports.topic_map import TF_TYPES, ForeignTopic

Pose = ros.geometry_msgs__msg__Pose
PoseWithCovariance = ros.geometry_msgs__msg__PoseWithCovariance


@dataclass(frozen=True)
class StampedPose:
    """One pose of a topic.

    Attributes:
        header: Its header.
        pose: With covariance, zeros where the message has none.
        child_frame: What it is the pose of, "" where the message does not say.
    """

    header: Any
    pose: Any
    child_frame: str


def poses_in(message: Any, msgtype: str, topic: ForeignTopic) -> list[StampedPose]:
    """The poses a message holds; of a transform message those between the wanted frames."""
    if msgtype in TF_TYPES:
        return [_of_transform(each) for each in message.transforms if _wanted(each, topic)]
    match msgtype:
        case "geometry_msgs/msg/TransformStamped":
            return [_of_transform(message)] if _wanted(message, topic) else []
        case "nav_msgs/msg/Odometry":
            return [StampedPose(message.header, message.pose, message.child_frame_id.lstrip("/"))]
        case "geometry_msgs/msg/PoseWithCovarianceStamped":
            return [StampedPose(message.header, message.pose, "")]
        case _:
            return [StampedPose(message.header, PoseWithCovariance(message.pose, np.zeros(36)), "")]


def _wanted(transform: Any, topic: ForeignTopic) -> bool:
    parent, child = transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")
    return (topic.parent is None or parent == topic.parent.lstrip("/")) and (
        topic.child is None or child == topic.child.lstrip("/")
    )


def _of_transform(transform: Any) -> StampedPose:
    pose = Pose(transform.transform.translation, transform.transform.rotation)
    return StampedPose(
        transform.header, PoseWithCovariance(pose, np.zeros(36)), transform.child_frame_id.lstrip("/")
    )
