from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.accuracy import accuracy, true_poses, world_from_truth
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize_from_measurements
from mulan.mission.photograph_information import (
    PhotographInformation,
    read_photograph_information,
    write_photograph_information,
)
from mulan.mission.types import Mission

from .team import draw_measurements, make_team

SIGMA = np.array([0.002, 0.002, 0.002, 0.005, 0.005, 0.005])


def flown(seed, photos=12):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, n=50, photos=photos, yaw_deg=0.3, percent=3.0)
    bearings, ranges = draw_measurements(rng, robots, bearings=6, ranges=20)
    return rng, robots, bearings, ranges


def refined(rng, robots, away=None):
    """Photographs whose shape is known to SIGMA, and whose place as a whole is not."""
    T_world_truth = world_from_truth(Mission(robots))
    assert T_world_truth is not None
    true = []
    for robot in robots:
        T = true_poses(robot, T_world_truth, robot.photo_time_s)
        assert T is not None
        true.append(T @ robot.T_body_camera)
    T = np.concatenate(true)
    n = len(T)
    along = se3.adjoint(se3.inverse(T)).reshape(6 * n, 6)  # all cameras moved alike
    own = np.diag(np.tile(SIGMA**-2.0, n))
    information = own - own @ along @ np.linalg.solve(along.T @ own @ along, along.T @ own)
    T = T @ se3.exp(SIGMA * rng.normal(size=(n, 6)))
    if away is not None:
        T = se3.exp(away) @ T
    names = tuple(robot.name for robot in robots for _ in robot.photos)
    return PhotographInformation(
        names, np.concatenate([robot.photo_time_s for robot in robots]), T, information
    )


def test_photographs_sharpen_poses_and_the_covariance_stays_honest():
    before, after, nees = [], [], []
    for seed in range(3):
        rng, robots, bearings, ranges = flown(seed)
        mission, config = Mission(robots), LocalizationConfig()
        for photographs, errors in ((None, before), (refined(rng, robots), after)):
            found = localize_from_measurements(robots, bearings, ranges, config, photographs=photographs)
            figures = accuracy(found, mission)
            assert figures is not None
            errors.append(np.mean([figure.position_rms_m for figure in figures.values()]))
        nees.append(np.mean([figure.nees_per_dof for figure in figures.values()]))
    assert np.mean(after) < 0.7 * np.mean(before)
    assert 0.4 < np.mean(nees) < 2.0


def test_where_the_whole_map_lies_is_still_the_radios_affair():
    rng, robots, bearings, ranges = flown(0)
    near = refined(rng, robots)
    away = se3.exp(np.array([0.0, 0.0, 0.01, 0.05, -0.05, 0.03]))
    moved = replace(near, T_world_camera=away @ near.T_world_camera)
    found = [
        localize_from_measurements(robots, bearings, ranges, LocalizationConfig(), photographs=photographs)
        for photographs in (near, moved)
    ]
    poses = [one.trajectories["beta"].T_world_body[:, :3, 3] for one in found]
    assert np.abs(poses[0] - poses[1]).max() < 0.005


def test_what_is_written_is_read_and_damage_is_one_sentence(tmp_path):
    rng, robots, *_ = flown(0)
    path, found = tmp_path / "photographs.safetensors", refined(rng, robots)
    write_photograph_information(found, path)
    again = read_photograph_information(path)
    assert again.robots == found.robots
    np.testing.assert_array_equal(again.information, found.information)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(InputError, match="cannot be read"):
        read_photograph_information(path)
    with pytest.raises(InputError, match="does not exist"):
        read_photograph_information(tmp_path / "none")


def test_photographs_of_another_mission_are_refused():
    rng, robots, bearings, ranges = flown(0)
    found = refined(rng, robots)
    for wrong, words in (
        (replace(found, robots=("omega", *found.robots[1:])), "robot 'omega'"),
        (replace(found, time_s=found.time_s + 0.77), "no pose of alpha is estimated"),
    ):
        with pytest.raises(InputError, match=words):
            localize_from_measurements(robots, bearings, ranges, LocalizationConfig(), photographs=wrong)
