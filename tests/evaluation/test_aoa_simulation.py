import json

import numpy as np
import pytest

from mulan.cli import evaluate
from mulan.evaluation.aoa_metric.sweep import AoaMetricConfig, ErrorVariance, variance_in_windows
from mulan.evaluation.aoa_simulation.bounds import direction_bound, phase_information
from mulan.evaluation.aoa_simulation.links import loop, random_direction, simulate_link
from mulan.evaluation.aoa_simulation.trials import run_trial
from mulan.wireless.kappa_calibration import fit_kappa_calibration, load_kappa_calibration


def test_aoa_simulation_writes_figures_with_their_provenance(tmp_path):
    assert evaluate.main(["aoa-simulation", "--out", str(tmp_path), "--quick"]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["provenance"]["seed"] == 0
    assert [level["links"] for level in metrics["efficiency"]] == [4, 4]
    assert (tmp_path / "aoa-simulation.png").stat().st_size > 1000


def test_aoa_metric_writes_figures_and_a_calibration(tmp_path):
    assert evaluate.main(["aoa-metric", "--out", str(tmp_path), "--quick"]) == 0
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    (aperture,) = metrics["apertures"]
    assert aperture["links"] == 20
    assert {"power_law", "power_law_of_absolute_error"} <= set(aperture)
    assert load_kappa_calibration(tmp_path / "kappa-calibration-0.2m.json").links == 20
    assert (tmp_path / "aoa-metric.png").stat().st_size > 1000


def test_wrapped_phase_holds_less_information_than_its_variance_says():
    assert phase_information(0.1) == pytest.approx(100, rel=1e-3)
    assert phase_information(1.5) < 0.6 / 1.5**2


def test_errors_are_near_the_bound():
    rng = np.random.default_rng(3)
    ratio = []
    for _ in range(16):
        link = simulate_link(loop(200, 0.5), 5.0, rng, 0.3)
        trial = run_trial(link, 5.0)
        bound = direction_bound(link.position_m, link.direction, 5.0, 0.3)
        ratio.append(trial.top_error_rad @ np.linalg.solve(bound, trial.top_error_rad) / 2)
    assert 0.6 < np.sqrt(np.mean(ratio)) < 1.5


def test_both_variances_of_the_error_are_what_they_are_called():
    metric, error = np.linspace(1, 2, 400), np.tile([0.1, 0.3], 200)
    config = AoaMetricConfig()
    _, square = variance_in_windows(metric, error, config)
    _, absolute = variance_in_windows(metric, error, config, ErrorVariance.OF_ABSOLUTE)
    np.testing.assert_allclose(square, 0.05, rtol=0.1)
    np.testing.assert_allclose(absolute, 0.01, rtol=0.1)


def test_power_law_of_the_metric_is_recovered_and_read_back(tmp_path):
    rng = np.random.default_rng(4)
    kappa = np.exp(rng.uniform(10, 15, 2000))
    sigma = 1e-6 * kappa**0.8
    error = np.linalg.norm(rng.normal(size=(2000, 2)), axis=1) * sigma
    wild = rng.random(2000) < 0.1
    error[wild] = [
        2 * np.arcsin(np.linalg.norm(random_direction(rng) - [0, 0, 1]) / 2) for _ in range(wild.sum())
    ]
    calibration = fit_kappa_calibration(kappa, error)
    assert calibration.exponent == pytest.approx(0.8, abs=0.05)
    assert calibration.outlier_mass == pytest.approx(0.1, abs=0.03)
    calibration.save(tmp_path / "law.json")
    assert load_kappa_calibration(tmp_path / "law.json") == calibration
