"""A foreign bag as a mission: each topic taken as the map says, its messages made into a mission's own."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.errors import InputError
from mulan.mission import messages, ros_camera, ros_poses
from mulan.mission.bag_mounts import Mounts
from mulan.mission.bag_reader import mission_of
from mulan.mission.bag_topics import BagTopics
from mulan.mission.imports import clocks, topic_map
from mulan.mission.imports.foreign_bag import ForeignBag, open_bag
from mulan.mission.imports.foreign_messages import BagImportConfig, taken
from mulan.mission.imports.static_frames import T_between
from mulan.mission.imports.toml_fields import CAMERA_EXAMPLE
from mulan.mission.imports.topic_map import TF_TYPES, ForeignTopic, RobotTopics, Role, TopicMap
from mulan.mission.messages import RobotFrames
from mulan.mission.ros_stamps import NANOSECONDS, stamp_s, to_stamp
from mulan.mission.types import Mission

Header = ros.std_msgs__msg__Header
Progress = Callable[[float, float, str], None]


@dataclass(frozen=True)
class ImportedMission:
    """A mission, and what a person should know about its clocks."""

    mission: Mission
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class _ForeignTopics(BagTopics):
    """Messages under a mission's names, spoken of by the names they had.

    Attributes:
        foreign: Those names by the mission's own.
    """

    foreign: dict[str, str] = field(default_factory=dict)

    def error(self, topic: str, problem: str, remedy: str) -> InputError:
        """The sentence for something wrong in a topic."""
        return super().error(self.foreign.get(topic, topic), problem, remedy)


@dataclass
class _Robot:
    """What was read of one robot."""

    topics: RobotTopics
    bag: Path
    found: dict[Role, list[Any]] = field(default_factory=dict)
    stamps: dict[ForeignTopic, clocks.StampLog] = field(default_factory=dict)
    body_frame: str = ""

    def header_frame(self, role: Role) -> str:
        """The frame in the headers of one topic, "" if there is none."""
        found = self.found.get(role)
        return found[0].header.frame_id.lstrip("/") if found else ""

    def seconds(self, role: Role) -> list[float]:
        """Times of one topic's messages."""
        return [stamp_s(message) for message in self.found[role]]

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last recording time."""
        times = [time_s for log in self.stamps.values() for time_s in log.record_s]
        return min(times), max(times)


def import_bag(path: Path, topics: TopicMap, config: BagImportConfig, progress: Progress) -> ImportedMission:
    """Read a foreign bag, or one a robot, as a mission.

    Photographs are compressed as they come, so only compressed ones are held in memory.

    Args:
        path: ROS 1 ``.bag``, ``.mcap``, ``.db3`` or rosbag2 folder; robots with a ``bag`` of their own in the
            map are read from that.
        topics: Which topic is what.
        config: How raw images are compressed.
        progress: Called with messages read and their total.

    Raises:
        InputError: A bag is missing or damaged; a topic is absent, empty, of a type that cannot be used, or
            holds something that cannot; clocks are apart; a calibration or mount is missing.
    """
    everyone = [*topics.robots, *([] if topics.held_out is None else [topics.held_out])]
    robots = [_Robot(each, each.bag or path) for each in everyone]
    mounts: dict[Path, Mounts] = {}
    for source in dict.fromkeys(robot.bag for robot in robots):
        of_bag = [robot for robot in robots if robot.bag == source]
        with open_bag(source) as bag:
            mounts[source] = _static_transforms(bag, topics.tf_static)
            _read(bag, of_bag, config, progress)
    remarks = _check_clocks([robot for robot in robots if robot.topics is not topics.held_out])
    return ImportedMission(_mission(path, topics, robots, mounts), tuple(remarks))


def _static_transforms(bag: ForeignBag, names: Sequence[str]) -> Mounts:
    static = {topic.name for topic in bag.topics if topic.name in names and topic.msgtype in TF_TYPES}
    found = [recorded.message for recorded in bag.messages(static)]
    return Mounts.of(BagTopics(bag.path, {messages.TF_STATIC: found}))


def _read(bag: ForeignBag, robots: list[_Robot], config: BagImportConfig, progress: Progress) -> None:
    routes: dict[str, list[tuple[_Robot, ForeignTopic]]] = {}
    counts = {}
    for robot in robots:
        for role, topic in robot.topics.topics.items():
            wanted_by = f"{role.key} of {robot.topics.name}"
            counts[topic.name] = bag.topic(topic.name, role.accepts, wanted_by).count
            routes.setdefault(topic.name, []).append((robot, topic))
            robot.found[role] = []
            robot.stamps[topic] = clocks.StampLog()
    for number, recorded in enumerate(bag.messages(routes)):
        progress(number, sum(counts.values()), "")
        for robot, topic in routes[recorded.topic]:
            try:
                arrived = taken(recorded, topic, config)
            except ValueError as error:
                raise InputError(
                    bag.path, f"topic {topic.name}", str(error), "record another kind, or convert it"
                ) from error
            for each in arrived:
                robot.found[topic.role].append(each.message)
                robot.stamps[topic].add(each.header_s, recorded.record_ns / NANOSECONDS)
                if topic.role is topic_map.ODOMETRY and each.child_frame:
                    robot.body_frame = robot.body_frame or each.child_frame
    for robot in robots:
        for role, found in robot.found.items():
            if not found:
                topic = robot.topics.topics[role]
                raise InputError(
                    bag.path,
                    f"topic {topic.name}",
                    f"holds no transform from {topic.parent or 'anything'} to {topic.child or 'anything'}",
                    "correct parent and child in the topic map",
                )
            found.sort(key=stamp_s)


def _check_clocks(robots: list[_Robot]) -> list[str]:
    remarks = []
    for robot in robots:
        bag, name = str(robot.bag), robot.topics.name
        clocks.check_robot(bag, robot.topics, robot.stamps)
        photo_s, odometry_s = robot.seconds(topic_map.IMAGE), robot.seconds(topic_map.ODOMETRY)
        remark = clocks.check_photos_within(bag, name, photo_s, odometry_s)
        remarks += [] if remark is None else [remark]
    return remarks + clocks.remarks_between({robot.topics.name: robot.span_s for robot in robots})


def _mission(path: Path, topics: TopicMap, robots: list[_Robot], mounts: dict[Path, Mounts]) -> Mission:
    found: dict[str, list[Any]] = {}
    foreign: dict[str, str] = {}
    stamp = to_stamp(0)
    transforms = []
    has_csi, has_ranges = (
        any(role in robot.found for robot in robots) for role in (topic_map.CSI, topic_map.RANGE)
    )
    for robot in robots:
        name = robot.topics.name
        for role, arrived in robot.found.items():
            found[role.target.of(name)] = arrived
            foreign[role.target.of(name)] = robot.topics.topics[role].name
        if robot.topics.camera is not None:
            info = ros_camera.to_camera_info(robot.topics.camera, Header(stamp, ""))
            found[messages.CAMERA_INFO.of(name)] = [info]
        elif topic_map.CAMERA_INFO not in robot.found:
            raise InputError(
                topics.path,
                f"robot {name}",
                "has no calibration: neither camera_info nor a camera table",
                f"add [robot.camera] with {CAMERA_EXAMPLE}",
            )
        if robot.topics is not topics.held_out:
            for child, T in _mounts(topics, robot, mounts[robot.bag], has_csi, has_ranges).items():
                header = Header(stamp, RobotFrames(name).body)
                transform = ros_poses.to_transform(T)
                transforms.append(ros.geometry_msgs__msg__TransformStamped(header, child, transform))
    names = [robot.name for robot in topics.robots]
    found[messages.ROBOTS] = [ros.std_msgs__msg__String(" ".join(names))]
    found[messages.TF_STATIC] = [ros.tf2_msgs__msg__TFMessage(transforms)]
    return mission_of(_ForeignTopics(path, found, foreign), names)


def _mounts(
    topics: TopicMap, robot: _Robot, tree: Mounts, has_csi: bool, has_ranges: bool
) -> dict[str, Float[NDArray, "4 4"]]:
    """Poses of camera and antennas on the body, by the names a mission gives their frames."""
    own, ours = robot.topics, RobotFrames(robot.topics.name)
    body = own.body_frame or robot.body_frame

    def between(frame: str) -> Float[NDArray, "4 4"] | None:
        return T_between(tree, body, frame) if body and frame else None

    def missing(sensor: str, frame: str, remedy: str) -> InputError:
        return InputError(
            topics.path,
            f"robot {own.name}",
            f"no static transform leads from its body ('{body or 'unnamed'}') to its {sensor}"
            f" ('{frame or 'unnamed'}')",
            f"correct the frames, or add {remedy}",
        )

    camera = own.camera_frame or robot.header_frame(topic_map.IMAGE)
    T_body_optical = own.T_body_optical if own.T_body_optical is not None else between(camera)
    if T_body_optical is None:
        raise missing("camera", camera, "[robot.camera_mount] with translation_m and quaternion_xyzw")
    result = {ours.camera_optical: T_body_optical}
    for child, given_m, frame, key, needed in (
        (
            ours.wifi_antenna,
            own.wifi_antenna_m,
            own.wifi_antenna_frame or robot.header_frame(topic_map.CSI) or ours.wifi_antenna,
            "wifi_antenna_m",
            has_csi,
        ),
        (
            ours.uwb_antenna,
            own.uwb_antenna_m,
            own.uwb_antenna_frame or robot.header_frame(topic_map.RANGE) or ours.uwb_antenna,
            "uwb_antenna_m",
            has_ranges,
        ),
    ):
        T = between(frame)
        if given_m is not None:
            T = np.eye(4)
            T[:3, 3] = given_m
        if T is not None:
            result[child] = T
        elif needed:
            raise missing(key.removesuffix("_m").replace("_", " "), frame, f"{key} = [x, y, z]")
    return result
