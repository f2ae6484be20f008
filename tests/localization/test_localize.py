import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.accuracy import accuracy, world_from_truth
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize, localize_from_measurements
from mulan.localization.run_files import write_localization
from mulan.mission.run_folder import RunFolder
from mulan.mission.types import Mission
from mulan.wireless.bearing import BearingConfig

from .team import draw_measurements, make_team


def run(seed, config=None, **measured):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, n=50, photos=25)
    bearings, ranges = draw_measurements(rng, robots, **measured)
    localization = localize_from_measurements(robots, bearings, ranges, config or LocalizationConfig())
    return localization, Mission(robots)


UNCHECKED = """
import json, time
import numpy as np
from mulan.localization.accuracy import accuracy
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize_from_measurements
from mulan.mission.types import Mission
from tests.localization.team import draw_measurements, make_team

def trial(seed, outliers):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, n=50, photos=25)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=25, outliers=outliers)
    found = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    result = accuracy(found, Mission(robots))
    claimed = np.einsum("nii->n", found.trajectories["beta"].covariance[:, 3:, 3:]).mean()
    nees = np.mean([r.nees_per_dof for r in result.values()])
    return [nees, result["beta"].position_rms_m ** 2, claimed]

trials = {share: [trial(seed, share) for seed in range(8)] for share in (0.0, 0.2)}
rng = np.random.default_rng(9)
robots = make_team(rng, n=100, photos=100)
bearings, ranges = draw_measurements(rng, robots, bearings=10, ranges=300)
begin = time.process_time()
found = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
seconds = time.process_time() - begin
photographs = len(found.trajectories["beta"].covariance)
print(json.dumps({"trials": trials, "seconds": seconds, "photographs": photographs}))
"""


@pytest.fixture(scope="module")
def unchecked():
    """In an interpreter of its own: here every shape is checked at run time, which users do not pay for."""
    root = Path(__file__).parents[2]
    ran = subprocess.run(
        [sys.executable, "-c", UNCHECKED], cwd=root, capture_output=True, text=True, check=True
    )
    return json.loads(ran.stdout)


def test_covariance_is_honest_the_error_is_what_it_allows_and_outliers_cost_little(unchecked):
    rms = {}
    for share, trials in unchecked["trials"].items():
        nees, squared, claimed = np.mean(trials, axis=0)
        rms[share] = np.sqrt(squared)
        assert 0.5 < nees < 1.5
        assert 0.7 < np.sqrt(squared / claimed) < 1.3
    assert rms["0.2"] < 1.4 * rms["0.0"]


def test_joint_covariance_agrees_with_that_of_each_photograph_and_of_pairs():
    localization, _ = run(0, bearings=8, ranges=25)
    joint = localization.joint_covariance
    assert joint is not None
    n = len(joint) // 6
    blocks = joint.reshape(n, 6, n, 6)
    each = np.concatenate([t.covariance for t in localization.trajectories.values()])
    np.testing.assert_allclose(np.einsum("iaib->iab", blocks), each, rtol=1e-3, atol=1e-3 * each.max())
    # neighbours drifted together, so they know their place beside each other far better than in the world
    beta = list(localization.trajectories).index("beta") * (n // len(localization.trajectories))
    own, step = blocks[beta + 5, 3:, beta + 5, 3:], np.zeros((3, 3))
    T = localization.trajectories["beta"].T_world_body[[5, 6]]
    A = se3.adjoint(se3.inverse(T[1]) @ T[0])[3:]
    for a, i in ((A, beta + 5), (-np.eye(6)[3:], beta + 6)):
        for b, j in ((A, beta + 5), (-np.eye(6)[3:], beta + 6)):
            step += a @ blocks[i, :, j, :] @ b.T
    assert np.trace(step) < 0.3 * np.trace(own)
    few = replace(LocalizationConfig(), most_joint_photographs=3)
    assert run(0, few, bearings=8, ranges=25)[0].joint_covariance is None


def test_outliers_are_told_from_good_bearings():
    rng = np.random.default_rng(3)
    robots = make_team(rng, n=50)
    good, ranges = draw_measurements(rng, robots, bearings=10, ranges=40)
    wrong, _ = draw_measurements(rng, robots, bearings=3, ranges=0, outliers=1.0)
    localization = localize_from_measurements(robots, [*good, *wrong], ranges, LocalizationConfig())
    assert localization.bearing_inlier[: len(good)].mean() > 0.9
    assert localization.bearing_inlier[len(good) :].mean() < 0.2


def test_a_second_hypothesis_is_taken_where_it_fits():
    rng = np.random.default_rng(4)
    robots = make_team(rng)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=40)
    ghost = rng.normal(size=3)
    mixed = [
        replace(
            b,
            direction_odom=np.stack([ghost / np.linalg.norm(ghost), b.direction_odom[0]]),
            tangent_covariance=np.repeat(b.tangent_covariance, 2, axis=0),
            weight=np.array([0.55, 0.4]),
        )
        if i % 4 == 0
        else b
        for i, b in enumerate(bearings)
    ]
    localization = localize_from_measurements(robots, mixed, ranges, LocalizationConfig())
    assert localization.bearing_inlier.mean() > 0.9


def test_the_anchor_starts_at_its_own_odometry():
    localization, mission = run(5, bearings=4, ranges=30)
    np.testing.assert_allclose(localization.T_world_odom["alpha"], np.eye(4), atol=1e-5)
    np.testing.assert_allclose(localization.trajectories["alpha"].T_world_body[0], np.eye(4), atol=1e-5)
    T = world_from_truth(mission)
    assert T is not None
    truth = mission.robots[0].ground_truth
    assert truth is not None
    np.testing.assert_allclose(T @ truth.T_world_body[0], np.eye(4), atol=1e-9)


def test_odometry_without_covariance_gets_the_default_drift():
    rng = np.random.default_rng(6)
    robots = make_team(rng, with_covariance=False)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=40)
    localization = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    result = accuracy(localization, Mission(robots))
    assert result is not None
    assert result["beta"].position_rms_m < 0.2
    assert result["beta"].nees_per_dof < 2


def test_six_freedoms_and_a_common_floor_work():
    six, mission = run(7, LocalizationConfig(gravity_aligned=False), bearings=8, ranges=40)
    result = accuracy(six, mission)
    assert result is not None
    assert result["beta"].position_rms_m < 0.4
    rng = np.random.default_rng(8)
    robots = make_team(rng, flat=True)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=40, level=True)
    floor = localize_from_measurements(
        robots, bearings, ranges, LocalizationConfig(common_floor_sigma_m=0.02)
    )
    heights = floor.trajectories["beta"].T_world_body[:, 2, 3]
    assert np.abs(heights).max() < 0.1


def test_two_hundred_keyframes_are_solved_within_five_seconds(unchecked):
    assert unchecked["photographs"] == 100
    assert unchecked["seconds"] < 5.0


def test_the_written_record_is_complete(tmp_path):
    localization, mission = run(10, bearings=4, ranges=30)
    write_localization(localization, mission, RunFolder(tmp_path))
    record = json.loads((tmp_path / "localization.json").read_text())
    conclusions = {"accuracy", "undetermined", "suspects", "odometry"}
    assert set(record) == {"anchor", "robots", "bearings", "ranges", "profile"} | conclusions
    beta = record["robots"]["beta"]
    assert len(beta["path"]) == len(beta["truth_path"]) <= 500
    np.testing.assert_allclose(beta["path"], beta["truth_path"], atol=1.0)
    assert record["bearings"][0]["error_rad"] < 0.2
    assert record["accuracy"]["beta"]["position_rms_m"] < 0.5
    cameras = json.loads((tmp_path / "poses" / "beta.json").read_text())
    expected = localization.trajectories["beta"].T_world_body @ mission.robots[1].T_body_camera
    np.testing.assert_allclose(cameras["T_world_camera"], expected, atol=1e-8)
    assert len((tmp_path / "poses" / "beta.tum").read_text().splitlines()) == 1 + len(expected)


def test_truth_is_optional(tmp_path):
    localization, mission = run(11, bearings=4, ranges=30)
    blind = Mission(tuple(replace(r, ground_truth=None) for r in mission.robots))
    assert accuracy(localization, blind) is None
    write_localization(localization, blind, RunFolder(tmp_path))
    record = json.loads((tmp_path / "localization.json").read_text())
    assert record["accuracy"] is None
    assert record["bearings"][0]["error_rad"] is None


def test_photographs_outside_the_odometry_are_refused():
    rng = np.random.default_rng(12)
    robots = make_team(rng)
    photo = replace(robots[1].photos[-1], time_s=500.0)
    late = (robots[0], replace(robots[1], photos=(*robots[1].photos, photo)))
    bearings, ranges = draw_measurements(rng, robots, bearings=4, ranges=30)
    with pytest.raises(InputError, match="beta"):
        localize_from_measurements(late, bearings, ranges, LocalizationConfig())


def test_one_robot_alone_is_its_odometry():
    rng = np.random.default_rng(13)
    (robot,) = make_team(rng, 1)
    localization = localize(Mission((robot,)), LocalizationConfig(), BearingConfig())
    T = se3.interpolate(robot.odometry.time_s, robot.odometry.T_odom_body, robot.photo_time_s)
    np.testing.assert_allclose(localization.trajectories["alpha"].T_world_body, T, atol=1e-5)


def test_an_empty_mission_is_refused():
    with pytest.raises(InputError, match="robots"):
        localize(Mission(()), LocalizationConfig(), BearingConfig())
