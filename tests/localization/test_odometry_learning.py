import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from mulan.geometry import se3
from mulan.localization.accuracy import true_poses, world_from_truth
from mulan.localization.graph import LocalizationConfig
from mulan.localization.keyframes import OdometryNoise
from mulan.localization.localize import localize_from_measurements
from mulan.localization.odometry_correction import Learning, OdometryLearningConfig
from mulan.mission.types import Mission

from .team import draw_measurements, make_team

TRUE_YAW_DEG, TRUE_PERCENT = 0.5, 3.0


def scaled(robot, scale):
    T = robot.odometry.T_odom_body.copy()
    T[:, :3, 3] *= scale
    return replace(robot, odometry=replace(robot.odometry, T_odom_body=T))


def level_nees(found, robots):
    """Mean squared error over heading and position in stated covariances: the simulated bodies never tilt."""
    T_world_truth, values = world_from_truth(Mission(robots)), []
    assert T_world_truth is not None
    for robot in robots:
        trajectory = found.trajectories[robot.name]
        true = true_poses(robot, T_world_truth, trajectory.time_s)
        xi = se3.log(se3.inverse(trajectory.T_world_body) @ true)[1:, 2:]
        covariance = trajectory.covariance[1:, 2:, 2:]
        values.append(np.einsum("ni,ni->n", xi, np.linalg.solve(covariance, xi[..., None])[..., 0]) / 4)
    return float(np.mean(values))


def run(seed, noise_factor, learning, scale=1.0, percent=TRUE_PERCENT):
    rng = np.random.default_rng(seed)
    robots = make_team(
        rng,
        n=80,
        photos=20,
        with_covariance=False,
        yaw_deg=TRUE_YAW_DEG,
        percent=percent,
        duration_s=800.0,
    )
    bearings, ranges = draw_measurements(rng, robots, bearings=38, ranges=80)
    robots = (robots[0], scaled(robots[1], 1 / scale))
    noise = OdometryNoise(
        rotation_deg_per_sqrt_m=TRUE_YAW_DEG * noise_factor,
        translation_percent=percent * noise_factor,
        tilt_deg=0.02,
    )
    config = replace(LocalizationConfig(), odometry_noise=noise, odometry_learning=learning)
    found = localize_from_measurements(robots, bearings, ranges, config)
    return found, level_nees(found, robots)


WRONG_NOISE = """
import numpy as np
from tests.localization.test_odometry_learning import OdometryLearningConfig, run
for factor in (1 / 3, 3.0):
    print(np.mean([run(70 + seed, factor, OdometryLearningConfig())[1] for seed in range(3)]))
"""


def test_covariances_stay_honest_when_the_assumed_noise_is_wrong_by_three():
    # in an interpreter of its own: here every shape is checked at run time, which users do not pay for
    root = Path(__file__).parents[2]
    ran = subprocess.run(
        [sys.executable, "-c", WRONG_NOISE], cwd=root, capture_output=True, text=True, check=True
    )
    for nees in map(float, ran.stdout.split()):
        assert 0.7 < nees < 1.5


def test_a_scale_error_is_learned_with_its_sigma():
    found, _ = run(80, 1.0, OdometryLearningConfig(), scale=1.03, percent=1.0)
    learned = found.odometry["beta"]
    assert learned.scale_sigma < 0.01
    assert abs(learned.scale - 1.03) < 3 * learned.scale_sigma
    assert abs(found.odometry["alpha"].scale - 1.0) < 3 * found.odometry["alpha"].scale_sigma


def test_reported_covariances_are_believed_unless_asked_otherwise():
    rng = np.random.default_rng(81)
    robots = make_team(rng, n=25, photos=5)
    bearings, ranges = draw_measurements(rng, robots, bearings=4, ranges=10)
    found = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    assert found.odometry["beta"].scale == 1.0
    assert found.odometry["beta"].scale_sigma == 0.0
    always = OdometryLearningConfig(scale=Learning.ALWAYS)
    found = localize_from_measurements(
        robots, bearings, ranges, replace(LocalizationConfig(), odometry_learning=always)
    )
    assert found.odometry["beta"].scale_sigma > 0
