"""What the learner or a person writes to a run reaches the robot, and stands in the bag before."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Reader

from mulan.fleet.base_station import BaseConfig, BaseStation
from mulan.fleet.ingest import IngestConfig
from mulan.fleet.live_state import LiveRobot, LiveState, write_state
from mulan.fleet.orders import Orders, goal_of
from mulan.fleet.robot_link import RobotConfig, RobotLink
from mulan.fleet.simulated_robot import RequestInbox
from mulan.fleet.zenoh_session import LinkConfig
from mulan.mission import messages
from mulan.mission.run_folder import RunFolder, write_json
from tests.mission.conftest import make_poses


def wait_for(done, seconds: float = 20.0) -> None:
    until_s = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < until_s, "it took too long"
        time.sleep(0.05)


def test_a_robot_is_asked_to_measure_once_for_each_new_pose(
    tmp_path: Path, free_endpoint: LinkConfig
) -> None:
    T_world_body, T_world_odom, T_body_camera = make_poses(3, np.random.default_rng(2))
    first = LiveRobot(12.5, T_world_body, np.eye(6), T_world_odom, T_body_camera, measure_with=("bee",))
    run, inbox = RunFolder(tmp_path / "run"), RequestInbox()
    assert inbox.take(), "who was never told anything measures"
    config = BaseConfig(tmp_path / "m.mcap", mission="m", link=free_endpoint)
    base = BaseStation(config)
    orders = Orders(base, run)
    robot = RobotConfig("ant", tmp_path / "ant.spool", "m", link=free_endpoint)
    link = RobotLink(robot, orders={messages.REQUEST: inbox.put})
    try:
        write_state(LiveState(5 * 10**9, {"ant": first}), run)
        wait_for(lambda: inbox.received == 1)
        assert inbox.take()
        write_state(LiveState(6 * 10**9, {"ant": first}), run)  # planned anew, not localized anew
        time.sleep(1.5)
        assert inbox.received == 1
        assert not inbox.take(), "a request is answered once"
        write_state(LiveState(7 * 10**9, {"ant": replace(first, time_s=13.0, measure_with=())}), run)
        wait_for(lambda: inbox.received == 2)
        assert not inbox.take(), "nobody is to answer, so nothing is measured"
    finally:
        link.close()
        orders.close()
        base.close()
    with Reader(config.out) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts[messages.REQUEST.of("ant")] == 2


def test_planned_and_picked_goals_reach_the_robot_and_the_bag(
    tmp_path: Path, free_endpoint: LinkConfig
) -> None:
    rng = np.random.default_rng(1)
    T_world_body, T_world_odom, T_body_camera, planned, picked = make_poses(5, rng)
    robot = LiveRobot(12.5, T_world_body, np.eye(6) * 1e-4, T_world_odom, T_body_camera)
    run, said = RunFolder(tmp_path / "run"), []
    heard: list[Any] = []
    config = BaseConfig(
        tmp_path / "m.mcap", mission="m", link=free_endpoint, ingest=IngestConfig(robots=("ant", "bee"))
    )
    base = BaseStation(config)
    orders = Orders(base, run, said.append)
    link = RobotLink(
        RobotConfig("ant", tmp_path / "ant.spool", "m", link=free_endpoint),
        orders={messages.GOAL: heard.append},
    )
    try:
        write_state(LiveState(5 * 10**9, {"ant": robot}), run)
        write_state(LiveState(6 * 10**9, {"ant": robot_with(robot, planned)}), run)
        wait_for(lambda: heard)
        # a person at the page wants another view, and one of a robot nobody has placed
        entries = {name: {"T_world_camera": picked.tolist()} for name in ("ant", "bee")}
        write_json(run.root / "goals.json", entries)
        wait_for(lambda: heard[-1].header.stamp.sec != 6)
        write_json(run.root / "goals.json", {"ant": {"T_world_camera": [1.0]}})
        wait_for(lambda: len(said) >= 2)
    finally:
        link.close()
        orders.close()
        base.close()
    for message, goal in ((heard[0], planned), (heard[-1], picked)):
        assert message.header.frame_id == "ant/odom"
        assert np.allclose(T_world_odom @ goal_of(message) @ T_body_camera, goal, atol=1e-6)
    assert said[0] == "bee: has no place yet, so it cannot be told where to go"
    assert "is no camera pose" in said[1]
    with Reader(config.out) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts[messages.GOAL.of("ant")] == 2, "said again and again, but recorded once"
    assert counts[messages.POSE.of("ant")] >= 1


def robot_with(robot: LiveRobot, goal: np.ndarray) -> LiveRobot:
    return LiveRobot(
        robot.time_s, robot.T_world_body, robot.covariance, robot.T_world_odom, robot.T_body_camera, goal
    )
