"""A mission as one ROS 2 bag: a single MCAP file of standard messages."""

import os
import re
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.errors import InputError
from mulan.mission import messages, robot_messages, ros_stamps
from mulan.mission.run_folder import write_atomically
from mulan.mission.types import Mission

ROBOT_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")  # what ROS allows between two slashes
_BAG_VERSION = 9
# a player started late still gets the last message of these topics
_LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(0, 0),
    QosTime(0, 0),
    QosLiveliness.SYSTEM_DEFAULT,
    QosTime(0, 0),
    False,
)


@dataclass
class _Channel:
    topic: str
    msgtype: str
    latched: bool
    stamped: list[tuple[int, Any]] = field(default_factory=list)


def write_mission(mission: Mission, path: Path) -> None:
    """Write a mission as one zstd-compressed MCAP file that ROS 2, Foxglove and ``mcap`` open.

    Messages lie in order of time, each logged at its own header stamp. Conventions are those of ROS: the
    camera frame has REP-103 optical axes, covariances are over (x, y, z, fixed-axis rotations), pixel (0,
    0) is centred at (0, 0).

    Args:
        mission: What to write; the order of robots is kept in ``/robots``.
        path: Target, ending in ``.mcap``; replaced only when the new file is complete.

    Raises:
        InputError: The name does not end in ``.mcap``, a robot's name is no ROS name or is taken twice, a
            time does not fit a ROS stamp, or the disk is full.
    """
    if path.suffix != ".mcap":
        raise InputError(path, "file name", "does not end in .mcap", "choose a name such as mission.mcap")
    _check_names(mission, path)
    try:
        channels = _channels(mission)
    except ValueError as error:
        raise InputError(
            path, "header.stamp", str(error), "count time from the Unix epoch or from power-on"
        ) from error
    write_atomically(path, lambda temporary: _write(channels, path.stem, temporary))


def _check_names(mission: Mission, path: Path) -> None:
    names = [log.name for log in mission.robots]
    for name in names:
        if not ROBOT_NAME.fullmatch(name) or name == messages.HELD_OUT:
            raise InputError(
                path,
                f"robot name '{name}'",
                "cannot be a ROS namespace",
                "use letters, digits and underscores",
            )
    if len(set(names)) < len(names):
        raise InputError(path, "robot names", "are not all different", "give every robot its own name")


def _channels(mission: Mission) -> list[_Channel]:
    channels = []
    for log in mission.robots:
        stamped = robot_messages.of_robot(log)
        channels += [
            _Channel(topic.of(log.name), topic.msgtype, False, found) for topic, found in stamped.items()
        ]
    if mission.held_out is not None:
        stamped = robot_messages.of_held_out(mission.held_out)
        channels += [
            _Channel(topic.of(messages.HELD_OUT), topic.msgtype, False, found)
            for topic, found in stamped.items()
        ]
    start_ns = min((time_ns for channel in channels for time_ns, _ in channel.stamped), default=0)
    stamp = ros_stamps.to_stamp(start_ns)
    names = ros.std_msgs__msg__String(" ".join(log.name for log in mission.robots))
    mounts = [mount for log in mission.robots for mount in robot_messages.mounts(log, stamp)]
    latched = [
        _Channel(messages.ROBOTS, messages.ROBOTS_TYPE, True, [(start_ns, names)]),
        _Channel(
            messages.TF_STATIC,
            messages.TF_STATIC_TYPE,
            True,
            [(start_ns, ros.tf2_msgs__msg__TFMessage(mounts))],
        ),
    ]
    cameras = {log.name: log.camera for log in mission.robots}
    if mission.held_out is not None:
        cameras[messages.HELD_OUT] = mission.held_out.camera
    for name, camera in cameras.items():
        info = robot_messages.calibration(name, camera, stamp)
        topic = messages.CAMERA_INFO
        latched.append(_Channel(topic.of(name), topic.msgtype, True, [(start_ns, info)]))
    return latched + channels


def _write(channels: list[_Channel], name: str, target: Path) -> None:
    store = messages.typestore()
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=target.parent) as folder:
        writer = Writer(Path(folder) / name, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connections = [
                writer.add_connection(
                    channel.topic,
                    channel.msgtype,
                    typestore=store,
                    offered_qos_profiles=[_LATCHED] if channel.latched else [],
                )
                for channel in channels
            ]
            queue = [(t, i, message) for i, channel in enumerate(channels) for t, message in channel.stamped]
            for i in np.argsort(np.array([t for t, _, _ in queue], dtype=np.int64), kind="stable"):
                time_ns, channel, message = queue[i]
                data = store.serialize_cdr(message, channels[channel].msgtype)
                writer.write(connections[channel], time_ns, data)
        os.replace(Path(folder) / name / f"{name}.mcap", target)
