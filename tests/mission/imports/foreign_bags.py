"""Bags as other projects record them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.mission import messages
from mulan.mission.ros_stamps import to_nanoseconds, to_stamp

Message = tuple[str, float, Any]  # topic, recording time [s], message
Quaternion = ros.geometry_msgs__msg__Quaternion
UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)


def header(time_s: float, frame: str) -> Any:
    return ros.std_msgs__msg__Header(to_stamp(to_nanoseconds(time_s)), frame)


def raw_image(time_s: float, encoding: str, pixels: np.ndarray, padding: int = 0) -> Any:
    rows = pixels.reshape(len(pixels), -1)
    data = np.pad(rows, ((0, 0), (0, padding)))
    return ros.sensor_msgs__msg__Image(
        header(time_s, "cam0"), len(pixels), pixels.shape[1], encoding, 0, data.shape[1], data.ravel()
    )


def odometry(time_s: float, x_m: float) -> Any:
    pose = ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(x_m, 0.0, 0.0), UPRIGHT)
    zero = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
    twist = ros.geometry_msgs__msg__TwistWithCovariance(
        ros.geometry_msgs__msg__Twist(zero, zero), np.zeros(36)
    )
    with_covariance = ros.geometry_msgs__msg__PoseWithCovariance(pose, np.zeros(36))
    return ros.nav_msgs__msg__Odometry(header(time_s, "odom"), "imu", with_covariance, twist)


def posed(time_s: float, x_m: float) -> Any:
    pose = ros.geometry_msgs__msg__Pose(ros.geometry_msgs__msg__Point(x_m, 0.0, 0.0), UPRIGHT)
    return ros.geometry_msgs__msg__PoseStamped(header(time_s, "odom"), pose)


def transform(time_s: float, parent: str, child: str, xyz: Sequence[float]) -> Any:
    moved = ros.geometry_msgs__msg__Transform(ros.geometry_msgs__msg__Vector3(*map(float, xyz)), UPRIGHT)
    return ros.geometry_msgs__msg__TransformStamped(header(time_s, parent), child, moved)


def drone(photos: int = 3, image_offset_s: float = 0.0, encoding: str = "rgb8") -> list[Message]:
    """One flying camera as a visual-inertial data set has it: raw images, odometry, vicon, transforms."""
    found: list[Message] = []
    for k in range(20):
        t = 1000.0 + 0.1 * k
        found.append(("/vio/odometry", t + 0.01, odometry(t, 0.1 * k)))
        found.append(("/vicon/drone", t + 0.01, posed(t, 0.1 * k)))
        moving = transform(t, "odom", "imu", (0.1 * k, 0.0, 0.0))
        other = transform(t, "odom", "goal", (9.0, 0.0, 0.0))
        found.append(("/tf", t + 0.01, ros.tf2_msgs__msg__TFMessage([moving, other])))
    static = [transform(0.0, "base", "imu", (0, 0, 0.1)), transform(0.0, "base", "cam0", (0.2, 0, 0))]
    found.append(("/tf_static", 1000.0, ros.tf2_msgs__msg__TFMessage(static)))
    channels = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1}.get(encoding, 3)
    rng = np.random.default_rng(0)
    for k in range(photos):
        t = 1000.25 + 0.5 * k
        pixels = rng.integers(0, 256, (6, 8, channels), np.uint8)
        found.append(("/cam0/image_raw", t + 0.02, raw_image(t + image_offset_s, encoding, pixels)))
    return found


def write_ros2(path: Path, recorded: list[Message], plugin: StoragePlugin = StoragePlugin.MCAP) -> Path:
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, time_s, message in sorted(recorded, key=lambda each: each[1]):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, message.__msgtype__, typestore=messages.typestore()
                )
            data = messages.typestore().serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], to_nanoseconds(time_s), data)
    return path


def as_ros1(bag: Path, path: Path) -> Path:
    """The same recording as ROS 1 writes it: its own headers, CameraInfo with capital letters."""
    from rosbags.convert.converter import migrate_message
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import get_types_from_msg

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(messages.CSI_DEFINITION, messages.CSI_TYPE))
    store.register(get_types_from_msg(messages.RANGE_DEFINITION, messages.RANGE_TYPE))
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", messages.TF_STATIC_TYPE))
    cache: dict[str, object] = {}
    with AnyReader([bag], default_typestore=messages.typestore()) as reader, Writer1(path) as writer:
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=store) for c in reader.connections
        }
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            moved = migrate_message(
                reader.typestore, store, connection.msgtype, connection.msgtype, cache, message
            )
            writer.write(connections[connection.id], time_ns, store.serialize_ros1(moved, connection.msgtype))
    return path


def as_ros2(bag: Path, folder: Path, plugin: StoragePlugin) -> Path:
    """The same recording in another storage."""
    from rosbags.highlevel import AnyReader

    with (
        AnyReader([bag], default_typestore=messages.typestore()) as reader,
        Writer(folder, version=9, storage_plugin=plugin) as writer,
    ):
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=messages.typestore())
            for c in reader.connections
        }
        for connection, time_ns, data in reader.messages():
            writer.write(connections[connection.id], time_ns, data)
    return folder
