"""A robot of ROS 2 behind a bridge's key names, played by a second Zenoh session."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.rosbag2 import Reader

from mulan.errors import InputError
from mulan.fleet.base_station import BaseConfig, BaseStation
from mulan.fleet.ingest import IngestConfig
from mulan.fleet.message_choice import ChoiceConfig, MessageChoice
from mulan.fleet.odometry_thinning import OdometryConfig
from mulan.fleet.orders import goal_message
from mulan.fleet.robot_link import RobotConfig, RobotLink
from mulan.fleet.ros_robot import RosConfig, RosRobot
from mulan.fleet.wire_topics import WIRE_TOPICS
from mulan.fleet.zenoh_session import LinkConfig
from mulan.mission import messages
from mulan.mission.bag_reader import read_mission
from mulan.mission.ros_stamps import to_stamp
from tests.fleet.conftest import EPOCH_NS, Recorded, free_port, recorded_by

NOW_NS = time.time_ns()


def published_now(message: Recorded) -> bytes:
    """A message as if it were recorded now, not when the small log was."""
    store, msgtype = messages.typestore(), WIRE_TOPICS[message.suffix].topic.msgtype
    decoded: Any = store.deserialize_cdr(message.payload, msgtype)
    if hasattr(decoded, "header"):
        stamp = to_stamp(NOW_NS + message.record_ns - EPOCH_NS)
        decoded = replace(decoded, header=replace(decoded.header, stamp=stamp))
    return bytes(store.serialize_cdr(decoded, msgtype))


def wait_for(done: Callable[[], object], seconds: float = 20.0) -> None:
    until_s = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < until_s, "it took too long"
        time.sleep(0.02)


class Bridge:
    """What a zenoh-bridge-ros2dds does for a robot whose namespace is its name."""

    def __init__(self, endpoint: str) -> None:
        config = zenoh.Config()
        for name, value in (
            ("mode", '"router"'),
            ("listen/endpoints", f'["{endpoint}"]'),
            ("scouting/multicast/enabled", "false"),
        ):
            config.insert_json5(name, value)
        self.session = zenoh.open(config)
        self.heard: list[tuple[str, bytes]] = []
        self._subscriber = self.session.declare_subscriber(
            "ant/*", lambda s: self.heard.append((str(s.key_expr), s.payload.to_bytes()))
        )

    def keep(self, key: str, payload: bytes) -> None:
        """Have a message of a transient-local topic for who asks."""
        at = f"@ros2_pub_cache/{self.session.info.zid()}/{key}"
        self._cache = self.session.declare_queryable(at, lambda query: query.reply(key, payload))


def test_ros_topics_reach_the_bag_and_goals_reach_ros(tmp_path: Path, free_endpoint: LinkConfig) -> None:
    recorded = recorded_by("ant", [])
    bridge = Bridge(f"tcp/127.0.0.1:{(port := free_port())}")
    mounts = next(m for m in recorded if m.suffix == "tf_static")
    bridge.keep("ant/tf_static", published_now(mounts))
    ingest = IngestConfig(robots=("ant",))
    base = BaseStation(BaseConfig(tmp_path / "m.mcap", "m", link=free_endpoint, ingest=ingest))
    choice = MessageChoice(ChoiceConfig(odometry=OdometryConfig(keyframe_s=0)))
    said: list[str] = []
    config = RosConfig(f"tcp/127.0.0.1:{port}", {"odom": "/ant/vio/odometry"})
    robot = RosRobot(config, choice, said.append)
    link = RobotLink(
        RobotConfig("ant", tmp_path / "ant.spool", "m", link=free_endpoint), orders=robot.orders("ant")
    )
    stop = threading.Event()
    thread = threading.Thread(target=robot.run, args=(link, stop.is_set))
    thread.start()
    try:
        wait_for(lambda: robot.done)  # the mounts were asked for, and came
        for message in recorded:
            key = "ant/vio/odometry" if message.suffix == "odom" else f"ant/{message.suffix}"
            if message is not mounts:
                bridge.session.put(key, published_now(message))
        for _ in range(5):  # with every photograph, as drivers do
            bridge.session.put("ant/camera/camera_info", published_now(recorded[0]))
        bridge.session.put("ant/csi", b"no message")
        wait_for(lambda: robot.done == len(recorded) + 6)
        assert link.drained(20)
        goal = goal_message("ant", np.eye(4), 12 * 10**9)
        for _ in range(3):
            base.order("ant", messages.GOAL, goal)
        wait_for(lambda: any(key == "ant/goal_pose" for key, _ in bridge.heard))
        time.sleep(1.5)  # the base station says it again
    finally:
        stop.set()
        thread.join()
        link.close()
        base.close()
        bridge.session.close()
    goals = [payload for key, payload in bridge.heard if key == "ant/goal_pose"]
    assert len(goals) == 1, "a repeated goal would start the robot's navigation anew"
    heard: Any = messages.typestore().deserialize_cdr(goals[0], messages.GOAL.msgtype)
    assert (heard.header.frame_id, heard.header.stamp.sec) == ("ant/odom", 0)
    assert robot.unreadable == 1
    assert said == ["ant/csi: is no mulan_msgs/msg/Csi"]
    log = read_mission(tmp_path / "m.mcap").robot("ant")
    with Reader(tmp_path / "m.mcap") as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts["/ant/camera/camera_info"] == counts["/tf_static"] == 1
    assert len(log.odometry.time_s) == sum(m.suffix == "odom" for m in recorded)
    assert len(log.photos) == sum(m.suffix == messages.IMAGE.suffix for m in recorded)


def test_a_topic_no_mission_has_is_named() -> None:
    with pytest.raises(InputError, match="is no topic of a mission"):
        RosRobot(RosConfig("tcp/127.0.0.1:1", {"lidar": "/scan"}), MessageChoice(ChoiceConfig()))
