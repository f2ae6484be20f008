"""A ROS 2 bag as a mission."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission import bag_csi, bag_topics, bag_tracks, messages
from mulan.mission.bag_mounts import Mounts
from mulan.mission.bag_topics import BagTopics
from mulan.mission.bag_writer import ROBOT_NAME
from mulan.mission.messages import RobotFrames
from mulan.mission.ros_poses import T_OPTICAL_OPENGL
from mulan.mission.types import HeldOutViews, Mission, RobotLog


def read_mission(path: Path) -> Mission:
    """Read a mission from one MCAP file, or from the folder ``ros2 bag record`` makes.

    A robot is a namespace with a camera and odometry. Robots come in the order ``/robots`` gives (the first
    is the anchor), or by name where a bag has no such topic. Messages are sorted by header stamp; other
    topics are ignored.

    Raises:
        InputError: The bag is missing, damaged or cut short; no robot is in it; or a topic holds something
            that cannot be used. The sentence names the topic.
    """
    names = bag_topics.topic_names(path)
    robots = _robots(path, names)
    namespaces = [*robots, messages.HELD_OUT]
    types = {topic.of(name): topic.msgtype for name in namespaces for topic in messages.ROBOT_TOPICS}
    types |= {messages.TF_STATIC: messages.TF_STATIC_TYPE, messages.ROBOTS: messages.ROBOTS_TYPE}
    return mission_of(bag_topics.load(path, types), robots)


def robots_of(path: Path) -> list[str]:
    """Names of a mission's robots, the anchor first, without reading what they recorded.

    Raises:
        InputError: The bag is missing, damaged or cut short, or no robot is in it.
    """
    robots = _robots(path, bag_topics.topic_names(path))
    return _ordered(bag_topics.load(path, {messages.ROBOTS: messages.ROBOTS_TYPE}), robots)


def mission_of(bag: BagTopics, robots: list[str]) -> Mission:
    """The mission of messages under the names a mission bag gives them.

    Raises:
        InputError: As :func:`read_mission`.
    """
    mounts = Mounts.of(bag)
    needs_wifi = any(bag.has(messages.CSI.of(name)) for name in robots)
    needs_uwb = any(bag.has(messages.RANGE.of(name)) for name in robots)
    logs = [_robot(bag, mounts, name, needs_wifi, needs_uwb) for name in _ordered(bag, robots)]
    return Mission(tuple(logs), _held_out(bag))


def _robots(path: Path, names: list[str]) -> list[str]:
    """Namespaces with images and odometry, sorted."""
    suffix = f"/{messages.IMAGE.suffix}"
    imaging = [name.removesuffix(suffix)[1:] for name in names if name.endswith(suffix)]
    imaging = sorted(name for name in imaging if ROBOT_NAME.fullmatch(name) and name != messages.HELD_OUT)
    robots = [name for name in imaging if messages.ODOMETRY.of(name) in names]
    if not robots:
        raise InputError(
            path,
            "topics",
            f"no robot has both /<robot>/{messages.IMAGE.suffix} and /<robot>/{messages.ODOMETRY.suffix}"
            f" (found: {', '.join(names) or 'none'})",
            "record both under one namespace a robot",
        )
    if lost := sorted(set(imaging) - set(robots)):
        topic = messages.ODOMETRY.of(lost[0])
        raise InputError(
            path, f"topic {topic}", "is missing beside the robot's images", "record the robot's odometry"
        )
    return robots


def _ordered(bag: BagTopics, robots: list[str]) -> list[str]:
    """The recorded order first, then whoever it does not name."""
    recorded = [name for message in bag.of(messages.ROBOTS)[:1] for name in message.data.split()]
    first = [name for name in dict.fromkeys(recorded) if name in robots]
    return first + [name for name in robots if name not in first]


def _robot(bag: BagTopics, mounts: Mounts, name: str, needs_wifi: bool, needs_uwb: bool) -> RobotLog:
    frames = RobotFrames(name)
    camera = bag_tracks.camera(bag, name)

    def lever_arm(frame: str, needed: bool) -> Float[NDArray, "3"]:
        return mounts.T_parent_child(frames.body, frame)[:3, 3].copy() if needed else np.zeros(3)

    return RobotLog(
        name=name,
        camera=camera,
        T_body_camera=mounts.T_parent_child(frames.body, frames.camera_optical) @ T_OPTICAL_OPENGL,
        wifi_antenna_body_m=lever_arm(frames.wifi_antenna, needs_wifi or mounts.has(frames.wifi_antenna)),
        uwb_antenna_body_m=lever_arm(frames.uwb_antenna, needs_uwb or mounts.has(frames.uwb_antenna)),
        photos=bag_tracks.photos(bag, name, camera),
        odometry=bag_tracks.odometry(bag, name),
        csi=bag_csi.csi(bag, name),
        ranges=bag_tracks.ranges(bag, name),
        ground_truth=bag_tracks.poses(bag, name),
    )


def _held_out(bag: BagTopics) -> HeldOutViews | None:
    name = messages.HELD_OUT
    if not bag.of(messages.IMAGE.of(name)):
        return None
    camera = bag_tracks.camera(bag, name)
    photos = bag_tracks.photos(bag, name, camera)
    truth = bag_tracks.poses(bag, name)
    times_s = np.array([photo.time_s for photo in photos], dtype=float)
    if truth is None or not np.array_equal(truth.time_s, times_s):
        raise bag.error(
            messages.GROUND_TRUTH.of(name),
            "has not one pose with the stamp of each held-out photograph",
            "record one true camera pose a photograph, or leave the held-out topics out",
        )
    return HeldOutViews(camera, photos, truth.T_world_body @ T_OPTICAL_OPENGL)
