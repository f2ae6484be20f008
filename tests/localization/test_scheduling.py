import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from mulan.geometry import se3
from mulan.localization.online_estimate import OnlineEstimate
from mulan.localization.scheduling import SchedulingConfig, next_measurements


def team_of_three(sigma_m):
    """Along a line two metres apart, each position known to its own sigma."""
    names = ("alpha", "beta", "gamma")
    pose = {n: se3.from_parts(np.eye(3), np.array([2.0 * k, 0.0, 0.0])) for k, n in enumerate(names)}
    joint = np.diag(np.concatenate([[1e-4, 1e-4, 1e-4, s**2, s**2, s**2] for s in sigma_m]))
    covariance = {n: joint[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] for k, n in enumerate(names)}
    return OnlineEstimate(names, dict.fromkeys(names, 0.0), pose, covariance, joint, (0, 1, 2), {})


def test_sure_pairs_wait():
    assert next_measurements(team_of_three([1e-3, 0.02, 0.02]), SchedulingConfig()) == ()


def test_the_least_sure_robot_is_measured_and_busy_ones_are_left_alone():
    estimate = team_of_three([1e-3, 0.02, 1.0])
    (first,) = next_measurements(estimate, SchedulingConfig())
    assert "gamma" in (first.observer, first.peer)
    assert first.position_sigma_m > 1.0
    assert first.gain_nats > 0.5
    assert next_measurements(estimate, SchedulingConfig(), busy={"gamma"}) == ()


def test_a_robot_takes_part_in_one_aperture_at_a_time():
    found = next_measurements(team_of_three([1e-3, 1.0, 1.0]), SchedulingConfig(most=3))
    assert len(found) == 1


CLOCK_AND_NEED = """
import json
from mulan.evaluation.localization.online_run import run_team
from mulan.evaluation.localization.online_team import OnlineTeamConfig
from mulan.localization.online import OnlineConfig
from mulan.localization.scheduling import SchedulingConfig
team = OnlineTeamConfig(robots=3, hours=0.09, rest_s=60.0)
runs = [run_team(0, team, OnlineConfig(), by_need) for by_need in (None, SchedulingConfig())]
print(json.dumps([[run.apertures, run.rms_m] for run in runs]))
"""


def test_measuring_by_need_takes_fewer_apertures_than_a_clock_at_the_same_error():
    # in an interpreter of its own: here every shape is checked at run time, which users do not pay for
    root = Path(__file__).parents[2]
    ran = subprocess.run(
        [sys.executable, "-c", CLOCK_AND_NEED], cwd=root, capture_output=True, text=True, check=True
    )
    (clock_apertures, clock_m), (apertures, rms_m) = json.loads(ran.stdout)
    assert apertures < 0.5 * clock_apertures
    assert rms_m < 1.2 * clock_m
