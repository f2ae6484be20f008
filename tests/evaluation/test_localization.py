import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mulan.cli import evaluate
from mulan.errors import InputError
from mulan.evaluation.localization.bounds import camera_bound
from mulan.evaluation.localization.cases import judged
from mulan.evaluation.localization.simulated_team import Case, Noise
from mulan.evaluation.localization.trials import draw, run_trial, summed_up
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize_from_measurements

SMALL_CASES = """
import json
from mulan.evaluation.localization.simulated_team import Case, Noise
from mulan.evaluation.localization.trials import run_trial, summed_up
cases = [
    Case("pairs_20", 12, meetings=20, samples=41),
    Case("outliers_20", 8, meetings=20, outlier_share=0.2, samples=41),
    Case("drift_10", 8, meetings=10, drifting=True, samples=41),
    Case("robots_12", 1, robots=12, samples=21),
]
found = {c.name: [run_trial(c, Noise(), 0, i) for i in range(c.trials)] for c in cases}
print(json.dumps({c.name: summed_up(c, found[c.name]) for c in cases}))
"""


@pytest.fixture(scope="module")
def small_cases():
    """Small versions of the cases, in an interpreter of its own: here every shape is checked at run time."""
    root = Path(__file__).parents[2]
    ran = subprocess.run(
        [sys.executable, "-c", SMALL_CASES], cwd=root, capture_output=True, text=True, check=True
    )
    return json.loads(ran.stdout)


def test_errors_of_two_robots_are_near_the_bound_and_their_covariance_is_true(small_cases):
    line = small_cases["pairs_20"]
    assert line["rms_over_bound"] < 1.3
    assert 0.6 < line["nees_per_dof"] < 1.5
    assert line["refused"] == 0


def test_a_fifth_of_outliers_costs_little(small_cases):
    assert small_cases["outliers_20"]["rms_over_bound"] < 1.5
    assert small_cases["outliers_20"]["nees_per_dof"] < 1.8


def test_drift_is_in_the_covariance(small_cases):
    assert small_cases["drift_10"]["rms_over_bound"] < 1.4
    assert 0.5 < small_cases["drift_10"]["nees_per_dof"] < 1.6


def test_a_fleet_is_placed_through_robots_that_do_not_hear_the_anchor(small_cases):
    at = draw(Case("robots_12", 1, robots=12, samples=21), Noise(), 0, 0).range_at
    assert len(np.unique(at[(at[:, :2] == 0).any(1), :2])) < 12
    assert small_cases["robots_12"]["refused"] == 0
    assert small_cases["robots_12"]["rms_over_bound"] < 1.6


def test_the_bound_grows_with_the_noise():
    team = draw(Case("pairs_5", 1), Noise(), 0, 0)
    once = camera_bound(team, Noise(), drifting=False)
    twice = camera_bound(team, Noise(bearing_deg=10.0, range_m=0.10), drifting=False)
    np.testing.assert_allclose(twice, 4 * once, rtol=1e-6)


@pytest.mark.parametrize("drifting", [False, True])
def test_the_bound_is_infinite_where_no_right_measurement_ties_the_robots(drifting):
    team = draw(Case("pairs_1", 1, meetings=1), Noise(), 0, 0)
    lies = replace(
        team,
        bearing_right=np.zeros_like(team.bearing_right),
        range_right=np.zeros_like(team.range_right),
    )
    assert np.isinf(camera_bound(lies, Noise(), drifting)).all()


def test_the_bound_of_drift_becomes_that_of_exact_odometry():
    team = draw(Case("pairs_5", 1, samples=31), Noise(), 0, 0)
    exact = camera_bound(team, Noise(), drifting=False)
    nearly = camera_bound(team, Noise(drift_percent=1e-3, drift_deg_per_sqrt_m=1e-3), drifting=True)
    np.testing.assert_allclose(nearly, exact, rtol=1e-2)
    assert (camera_bound(team, Noise(), drifting=True) > exact).all()


@pytest.mark.parametrize("drifting", [False, True])
def test_the_bound_is_what_the_graph_claims_where_noise_is_small(drifting):
    noise = Noise(bearing_deg=0.5, range_m=0.005, drift_percent=0.3, drift_deg_per_sqrt_m=0.15)
    team = draw(Case("pairs_5", 1, samples=31, drifting=drifting), noise, 0, 0)
    config = LocalizationConfig(range_bias_sigma_m=0.0, range_outlier_mass=0.02)
    found = localize_from_measurements(team.robots, team.bearings, team.ranges, config)
    trajectory = found.trajectories["robot01"]
    T_body_camera = np.broadcast_to(team.robots[1].T_body_camera, trajectory.T_world_body.shape)
    claimed = se3.covariance_of_composition(T_body_camera, trajectory.covariance)[:, 3:, 3:]
    bound = camera_bound(team, noise, drifting)[0]
    np.testing.assert_allclose(np.einsum("nii->n", claimed), bound, rtol=0.1)


def test_outliers_carry_no_information():
    case = Case("outliers_5", 1, outlier_share=0.2)
    team = draw(case, Noise(), 0, 3)
    assert not team.bearing_right.all()
    everything = replace(team, bearing_right=np.ones_like(team.bearing_right))
    assert (camera_bound(team, Noise(), False) > camera_bound(everything, Noise(), False)).all()


def test_a_team_that_cannot_be_placed_is_counted_and_not_scored():
    case = Case("outliers_2", 1, meetings=2, outlier_share=0.2)
    trial = run_trial(case, Noise(), 0, 0)
    assert "robot01" in trial.refused
    assert summed_up(case, [trial])["refused"] == 1


def test_goals_are_judged_by_what_was_measured():
    case = {"meetings": 5, "rms_over_bound": 1.1, "nees_per_dof": 1.3}
    goals = judged({"pairs_5": case, "pairs_1": case | {"meetings": 1, "rms_over_bound": 9.0}})
    results = {name: goal["result"] for name, goal in goals.items()}
    assert list(results.values()) == ["pass", "short"]


def test_the_command_writes_figures_and_pictures_and_keeps_other_parts(tmp_path):
    (tmp_path / "metrics.json").write_text('{"real": {"euroc_mh": {"rms_m": 1.0}}}')
    options = ["--out", str(tmp_path), "--quick", "--only", "cases"]
    command = f"from mulan.cli import evaluate; raise SystemExit(evaluate.main({['localization', *options]}))"
    subprocess.run([sys.executable, "-c", command], check=True)
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["real"] == {"euroc_mh": {"rms_m": 1.0}}
    assert {"rms_m", "bound_m", "yaw_rms_deg", "nees_per_dof", "trials"} <= set(metrics["cases"]["pairs_5"])
    assert metrics["provenance"]["cases"]["seed"] == 0
    for picture in ("cases.png", "example.png"):
        assert (tmp_path / picture).stat().st_size > 1000


def test_an_unknown_part_is_refused(tmp_path):
    with pytest.raises(InputError, match="flights"):
        evaluate.main(["localization", "--out", str(tmp_path), "--only", "flights"])
