"""One recorded message as the message or messages a mission holds in that role."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.mission.imports import topic_map
from mulan.mission.imports.foreign_bag import Recorded
from mulan.mission.imports.foreign_images import Compression, compress
from mulan.mission.imports.foreign_poses import poses_in
from mulan.mission.imports.topic_map import ForeignTopic
from mulan.mission.ros_stamps import stamp_s, to_stamp

Header = ros.std_msgs__msg__Header


@dataclass(frozen=True)
class BagImportConfig:
    """How photographs that were recorded raw are compressed."""

    compression: Compression = "jpeg"
    """JPEG, or PNG without loss."""
    jpeg_quality: int = 95
    """1 to 100."""


@dataclass(frozen=True)
class Taken:
    """One message for a mission.

    Attributes:
        message: As the readers of a mission bag expect it.
        header_s: The stamp it came with, whichever clock counts.
        child_frame: What a pose is of, "" where nothing is said.
    """

    message: Any
    header_s: float
    child_frame: str = ""


@dataclass(frozen=True)
class _Posed:
    """What the readers of odometry and of true poses look at."""

    header: Any
    pose: Any


def taken(recorded: Recorded, topic: ForeignTopic, config: BagImportConfig) -> list[Taken]:
    """What a mission takes from one message; nothing from transforms between other frames.

    Raises:
        ValueError: An image cannot be used.
    """
    message = recorded.message

    def header(original: Any) -> Any:
        stamp = to_stamp(recorded.record_ns) if topic.clock == "record" else original.stamp
        return Header(stamp, original.frame_id)

    if topic.role is topic_map.ODOMETRY or topic.role is topic_map.GROUND_TRUTH:
        with_covariance = topic.role is topic_map.ODOMETRY
        return [
            Taken(
                _Posed(header(each.header), each.pose if with_covariance else each.pose.pose),
                stamp_s(each),
                each.child_frame,
            )
            for each in poses_in(message, recorded.msgtype, topic)
        ]
    header_s = stamp_s(message)
    if topic.role is topic_map.IMAGE:
        if recorded.msgtype == "sensor_msgs/msg/Image":
            data, form = compress(message, config.compression, config.jpeg_quality), config.compression
        else:
            data, form = message.data.tobytes(), message.format
        bytes_ = np.frombuffer(data, np.uint8)
        message = ros.sensor_msgs__msg__CompressedImage(header(message.header), form, bytes_)
    elif topic.role is topic_map.CAMERA_INFO:
        message = _camera_info(message, header(message.header))
    else:
        message.header = header(message.header)
    return [Taken(message, header_s)]


def _camera_info(message: Any, header: Any) -> Any:
    """ROS 1 writes the matrices' names in capitals."""
    names = "dkrp" if hasattr(message, "k") else "DKRP"
    D, K, R, P = (getattr(message, name) for name in names)
    return ros.sensor_msgs__msg__CameraInfo(
        header,
        message.height,
        message.width,
        message.distortion_model,
        D,
        K,
        R,
        P,
        message.binning_x,
        message.binning_y,
        message.roi,
    )
