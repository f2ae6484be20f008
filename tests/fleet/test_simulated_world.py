"""True robots go where their programs want, if nothing is in the way."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.fleet.orders import goal_message
from mulan.fleet.simulated_robot import GoalInbox, WorldClock
from mulan.fleet.simulated_world import SimulatedWorld, WorldConfig
from mulan.fleet.world_folder import WorldFolder
from mulan.geometry import se3
from mulan.mission.bag_reader import read_mission
from mulan.mission.run_folder import read_json, write_json
from mulan.mission.types import RobotLog
from mulan.simulation.from_scene import SceneMissionConfig, robot_cameras
from mulan.simulation.radio import RadioConfig
from mulan.simulation.recording import SensorConfig, body_poses

SCENE = SceneMissionConfig(
    robots=2,
    photos_per_robot=8,
    held_out=1,
    width=16,
    height=12,
    samples_per_pixel=1,
    sensors=SensorConfig(radio=RadioConfig(packets_per_second=20.0)),
)
CONFIG = WorldConfig(patience_s=0.3, scene=SCENE)


def log_of(folder: WorldFolder, leg: int, robot: str) -> RobotLog:
    return read_mission(folder.leg(leg) / f"{robot}.mcap").robots[0]


def after_two_legs(folder: Path, T_here_body: np.ndarray | None) -> tuple[SimulatedWorld, list[str]]:
    """Alpha has a wish for the second leg, beta says nothing."""
    said: list[str] = []
    world = SimulatedWorld(folder, CONFIG, said.append)
    wish = None if T_here_body is None else T_here_body.tolist()
    write_json(world.folder.wish("alpha", 1), {"T_here_body": wish})
    world.run(lambda: world.legs == 2)
    return world, said


def true_bodies() -> np.ndarray:
    return body_poses(robot_cameras(SCENE, 0))


def test_a_robot_goes_to_its_goal_and_its_odometry_goes_on(tmp_path: Path) -> None:
    bodies = true_bodies()
    goal = se3.inverse(bodies[2]) @ bodies[5]
    world, said = after_two_legs(tmp_path / "world", goal)
    assert world.obeyed == {"alpha": 1, "beta": 0}
    assert not said
    first, second = log_of(world.folder, 0, "alpha"), log_of(world.folder, 1, "alpha")
    assert first.ground_truth is not None
    assert second.ground_truth is not None
    assert np.allclose(first.ground_truth.T_world_body[-1], bodies[2], atol=1e-6)
    assert np.allclose(second.ground_truth.T_world_body[-1], bodies[5], atol=1e-6)
    assert len(first.photos) == len(second.photos) == 3
    gap = np.linalg.norm(first.odometry.T_odom_body[-1, :3, 3] - second.odometry.T_odom_body[0, :3, 3])
    assert gap < 1e-6
    assert second.odometry.time_s[0] >= first.odometry.time_s[-1]
    # who says nothing takes no part, and is not heard by radio either
    assert first.csi["beta"].time_s.size
    assert "beta" not in second.csi
    assert not (world.folder.leg(1) / "beta.mcap").exists()
    assert read_json(world.folder.over, "a test")["legs"] == 2
    assert world.folder.held_out.exists()


def test_a_goal_inside_something_is_not_gone_to(tmp_path: Path) -> None:
    bodies = true_bodies()
    into_the_rover = bodies[2].copy()
    into_the_rover[:3, 3] = [0.0, 0.0, 0.3]
    world, said = after_two_legs(tmp_path / "world", se3.inverse(bodies[2]) @ into_the_rover)
    assert world.obeyed["alpha"] == 0
    assert said == ["alpha: the way to its goal is not free, it goes on with its tour"]
    truth = log_of(world.folder, 1, "alpha").ground_truth
    assert truth is not None
    assert np.allclose(truth.T_world_body[-1], bodies[4], atol=1e-6)


def test_only_who_was_asked_moves_its_antenna(tmp_path: Path) -> None:
    world = SimulatedWorld(tmp_path / "world", replace(CONFIG, measure="asked"))
    for name, measures in (("alpha", True), ("beta", False)):
        write_json(world.folder.wish(name, 1), {"T_here_body": None, "measures": measures})
    world.run(lambda: world.legs == 2)

    def observed_s(leg: int, robot: str) -> float:
        """How long a robot moved while it stood at a stop and heard the other."""
        log = log_of(world.folder, leg, robot)
        truth = log.ground_truth
        (track,) = log.csi.values()
        assert truth is not None
        T = se3.interpolate(truth.time_s, truth.T_world_body, track.time_s)
        moves = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1) > 1e-6
        return float(np.diff(track.time_s)[moves].sum())

    assert observed_s(0, "alpha") > 1.0, "before the base station says anything all measure"
    assert observed_s(0, "beta") > 1.0
    assert observed_s(1, "alpha") > 1.0
    assert observed_s(1, "beta") < 0.2


def test_an_earlier_world_is_not_written_over(tmp_path: Path) -> None:
    write_json(WorldFolder(tmp_path).world, {})
    with pytest.raises(InputError, match="holds an earlier world"):
        SimulatedWorld(tmp_path, CONFIG)
    with pytest.raises(InputError, match="start 'mulan fleet world'"):
        WorldClock(tmp_path / "elsewhere", 1.0)


def test_a_goal_said_again_is_one_goal() -> None:
    inbox = GoalInbox()
    first, second = (goal_message("ant", np.eye(4), stamp_ns) for stamp_ns in (10**9, 2 * 10**9))
    inbox.put(first)
    inbox.put(first)
    assert inbox.take() is first
    inbox.put(first)
    assert inbox.take() is None
    inbox.put(second)
    assert inbox.take() is second
    assert inbox.received == 2
