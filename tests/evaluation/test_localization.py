import json
from dataclasses import replace

import numpy as np
import pytest

from mulan.cli import evaluate
from mulan.errors import InputError
from mulan.evaluation.localization.bounds import camera_bound
from mulan.evaluation.localization.cases import judged
from mulan.evaluation.localization.simulated_team import Case, Noise
from mulan.evaluation.localization.trials import draw, run_trial, summed_up


def measured(case):
    return summed_up(case, [run_trial(case, Noise(), 0, i) for i in range(case.trials)])


def test_errors_of_two_robots_are_near_the_bound_and_their_covariance_is_true():
    line = measured(Case("pairs_20", 20, meetings=20, samples=41))
    assert line["rms_over_bound"] < 1.3
    assert 0.6 < line["nees_per_dof"] < 1.5
    assert line["refused"] == 0


def test_a_fifth_of_outliers_costs_little():
    line = measured(Case("outliers_20", 16, meetings=20, outlier_share=0.2, samples=41))
    assert line["rms_over_bound"] < 1.5
    assert line["nees_per_dof"] < 1.8


def test_drift_is_in_the_covariance():
    line = measured(Case("drift_10", 12, meetings=10, drifting=True, samples=41))
    assert 0.5 < line["nees_per_dof"] < 1.6
    assert line["rms_over_bound"] < 1.4


def test_a_fleet_is_placed_through_robots_that_do_not_hear_the_anchor():
    case = Case("robots_8", 2, robots=8, samples=41)
    at = draw(case, Noise(), 0, 0).range_at
    assert len(set(at[(at[:, :2] == 0).any(1), :2].ravel())) < case.robots
    line = measured(case)
    assert line["refused"] == 0
    assert line["rms_over_bound"] < 1.6


def test_the_bound_grows_with_the_noise():
    team = draw(Case("pairs_5", 1), Noise(), 0, 0)
    once = camera_bound(team, Noise(), drifting=False)
    twice = camera_bound(team, Noise(bearing_deg=10.0, range_m=0.10), drifting=False)
    np.testing.assert_allclose(twice, 4 * once, rtol=1e-6)


def test_the_bound_of_drift_becomes_that_of_exact_odometry():
    team = draw(Case("pairs_5", 1, samples=31), Noise(), 0, 0)
    exact = camera_bound(team, Noise(), drifting=False)
    nearly = camera_bound(team, Noise(drift_percent=1e-3, drift_deg_per_sqrt_m=1e-3), drifting=True)
    np.testing.assert_allclose(nearly, exact, rtol=1e-2)
    assert (camera_bound(team, Noise(), drifting=True) > exact).all()


def test_the_bound_is_what_least_squares_on_the_truth_scatters():
    """Far apart and nearly noiseless the problem is linear: errors scatter exactly as the bound says."""
    case, noise = Case("pairs_5", 40, samples=31), Noise(bearing_deg=0.05, range_m=0.0005)
    line = summed_up(case, [run_trial(case, noise, 1, i) for i in range(case.trials)])
    assert line["rms_over_bound"] == pytest.approx(1.0, abs=0.2)


def test_outliers_carry_no_information():
    case = Case("outliers_5", 1, outlier_share=0.2)
    team = draw(case, Noise(), 0, 3)
    assert not team.bearing_right.all()
    everything = replace(team, bearing_right=np.ones_like(team.bearing_right))
    assert (camera_bound(team, Noise(), False) > camera_bound(everything, Noise(), False)).all()


def test_goals_are_judged_by_what_was_measured():
    case = {"meetings": 5, "rms_over_bound": 1.1, "nees_per_dof": 1.3}
    goals = judged({"pairs_5": case, "pairs_1": case | {"meetings": 1, "rms_over_bound": 9.0}})
    results = {name: goal["result"] for name, goal in goals.items()}
    assert list(results.values()) == ["pass", "short"]


def test_the_command_writes_figures_and_pictures_and_keeps_other_parts(tmp_path):
    (tmp_path / "metrics.json").write_text('{"real": {"euroc_mh": {"rms_m": 1.0}}}')
    assert evaluate.main(["localization", "--out", str(tmp_path), "--quick", "--only", "cases"]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["real"] == {"euroc_mh": {"rms_m": 1.0}}
    assert {"rms_m", "bound_m", "yaw_rms_deg", "nees_per_dof", "trials"} <= set(metrics["cases"]["pairs_5"])
    assert metrics["provenance"]["cases"]["seed"] == 0
    for picture in ("cases.png", "example.png"):
        assert (tmp_path / picture).stat().st_size > 1000


def test_an_unknown_part_is_refused(tmp_path):
    with pytest.raises(InputError, match="flights"):
        evaluate.main(["localization", "--out", str(tmp_path), "--only", "flights"])
