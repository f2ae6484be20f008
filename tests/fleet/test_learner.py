"""The learner on a bag that grows: the same run as from the finished bag, and started again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mulan.fleet.journal import Entry, Journal
from mulan.fleet.learner import LearnConfig, Learner
from mulan.fleet.live_state import read_state
from mulan.fleet.measurement_requests import measurement_requests
from mulan.fleet.orders import goal_message, goal_of, pose_message
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.information import Undetermined
from mulan.localization.localize import localize
from mulan.localization.scheduling import SchedulingConfig
from mulan.mission import ros_poses
from mulan.mission.run_folder import RunFolder, read_json
from mulan.mission.types import Mission
from mulan.planning.candidates import CandidateConfig
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.team_plan import TeamPlanConfig
from mulan.reconstruction.train_config import TrainConfig
from mulan.report.page import write_report
from mulan.simulation.from_scene import SceneMissionConfig, simulate_from_scene
from mulan.simulation.radio import RadioConfig
from mulan.simulation.recording import SensorConfig
from mulan.simulation.timeline import TourConfig
from mulan.wireless.bearing import BearingConfig
from tests.fleet.growing import append_until, entries_of

BEARINGS = BearingConfig(azimuth_count=180, elevation_count=61)
CONFIG = LearnConfig(
    round_s=0.5,
    fewest_photographs=4,
    hold_out_every=4,
    bearings=BEARINGS,
    seen_views=4,
    plan=TeamPlanConfig(CandidateConfig(directions=3), FreeSpaceConfig(places=2), refinements=0),
    train=TrainConfig(image_size=24, batch_samples=2048),
)


@pytest.fixture(scope="module")
def mission() -> Mission:
    config = SceneMissionConfig(
        robots=2,
        photos_per_robot=6,
        held_out=0,
        width=24,
        height=18,
        samples_per_pixel=2,
        tour=TourConfig(rounds=3),
        sensors=SensorConfig(radio=RadioConfig(packets_per_second=60.0)),
    )
    return simulate_from_scene(config)


@pytest.fixture(scope="module")
def entries(mission: Mission, tmp_path_factory: pytest.TempPathFactory) -> list[Entry]:
    return entries_of(mission, tmp_path_factory.mktemp("bag"))


def test_a_grown_bag_gives_the_poses_of_the_finished_one_and_a_run_to_look_at(
    tmp_path: Path, mission: Mission, entries: list[Entry]
) -> None:
    path, run = tmp_path / "m.mcap", RunFolder(tmp_path / "run")
    journal = Journal(path)
    said: list[str] = []
    learner = Learner(path, run, CONFIG, said.append)
    rest = append_until(journal, entries, 0.6)
    stop_after_a_round = iter([False, False, False, True])
    assert not learner.follow(lambda: next(stop_after_a_round, True))
    first = len(read_json(run.transforms, "a test")["frames"])
    journal.append(rest)
    journal.close()
    # another process goes on where that one was
    again = Learner(path, run, CONFIG, said.append)
    assert again.training.progress.steps == learner.training.progress.steps > 0
    assert again.follow()
    assert len(read_json(run.transforms, "a test")["frames"]) == 12 > first
    state = read_state(run)
    batch = localize(mission, LocalizationConfig(), BEARINGS)
    for name, robot in state.robots.items():
        assert np.allclose(robot.T_world_body, batch.trajectories[name].T_world_body[-1], atol=1e-4)
        assert np.allclose(robot.covariance, batch.trajectories[name].covariance[-1], rtol=0.05, atol=1e-9)
    metrics = read_json(run.metrics, "a test")
    assert metrics["psnr_db"] > 8
    assert metrics["steps"] > learner.training.progress.steps
    assert run.plan.exists()
    assert "field" in write_report(run).read_text()
    settled = Learner(path, run, CONFIG)
    assert settled.follow()
    assert settled.training.progress.steps == metrics["steps"], "a finished run is left as it is"
    assert any("photographs of alpha, beta" in text for text in said)


def test_goals_and_poses_go_out_in_the_frames_ros_expects(
    tmp_path: Path, mission: Mission, entries: list[Entry]
) -> None:
    path, run = tmp_path / "m.mcap", RunFolder(tmp_path / "run")
    journal = Journal(path)
    journal.append(entries)
    journal.close()
    Learner(path, run, CONFIG).look(0.0)
    robot = read_state(run).robots["beta"]
    assert robot.T_world_camera_goal is None
    pose = pose_message(robot)
    assert pose.header.frame_id == "world"
    assert np.allclose(goal_of(pose.pose), robot.T_world_body)
    covariance = ros_poses.covariance_from_ros(robot.T_world_body, pose.pose.covariance.reshape(6, 6))
    assert np.allclose(covariance, robot.covariance)
    # the camera pose of beta's third photograph, as the world knows it
    log = mission.robot("beta")
    T_odom_body = se3.interpolate(log.odometry.time_s, log.odometry.T_odom_body, log.photo_time_s[2:3])[0]
    T_world_camera = robot.T_world_odom @ T_odom_body @ robot.T_body_camera
    goal = goal_message("beta", robot.T_odom_body_goal(T_world_camera), 1_700_000_000_123_456_789)
    assert goal.header.frame_id == "beta/odom"
    assert np.allclose(goal_of(goal), T_odom_body, atol=1e-9)
    assert goal.header.stamp.nanosec == 123_456_789


def test_pairs_that_are_not_sure_enough_are_asked_to_measure(mission: Mission) -> None:
    known = localize(mission, LocalizationConfig(), BEARINGS)
    contented = SchedulingConfig(position_goal_m=10.0, heading_goal_deg=90.0)
    assert measurement_requests(known, contented) == {"alpha": (), "beta": ()}
    strict = SchedulingConfig(position_goal_m=1e-3, heading_goal_deg=1e-3, least_gain_nats=1e-3)
    for found in (known, replace(known, joint_covariance=None)):
        asked = measurement_requests(found, strict)
        # one of the two moves its antenna, the other answers
        assert sorted(asked.values()) in ([(), ("alpha",)], [(), ("beta",)])
    lost = Undetermined("gamma", ("bearings and ranges",), "is silent", "wait")
    everyone = measurement_requests(replace(known, undetermined=(lost,)), contented)
    assert everyone == {"alpha": ("beta", "gamma"), "beta": ("alpha", "gamma")}


def test_a_bag_that_ends_before_anything_was_seen_is_no_error(tmp_path: Path) -> None:
    path, run = tmp_path / "m.mcap", RunFolder(tmp_path / "run")
    Journal(path).close()
    said: list[str] = []
    assert Learner(path, run, CONFIG, said.append).follow()
    assert said == ["the bag ended before anything could be learnt from it"]
    assert not run.transforms.exists()
