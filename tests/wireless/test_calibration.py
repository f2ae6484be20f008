from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.wireless.azimuth_density import azimuth_mixture
from mulan.wireless.calibration import (
    AzimuthCalibration,
    fit_calibration,
    mean_nll,
    read_calibration,
    write_calibration,
)
from mulan.wireless.directions import unit_direction
from mulan.wireless.types import Bearing


def claimed_and_true(rng, n, sigma_factor=3.0, floor_rad=0.02, outlier_rate=0.2):
    """Bearings that claim too little: sigma too small by a factor and a floor, outliers too rare."""
    bearings, truth = [], rng.uniform(-np.pi, np.pi, n)
    for t in truth:
        claimed = np.exp(rng.uniform(np.log(0.003), np.log(0.03), 2))
        off = np.hypot(sigma_factor * claimed[0], floor_rad) * rng.normal()
        azimuth = rng.uniform(-np.pi, np.pi, 2)
        if rng.random() > outlier_rate:
            azimuth[0] = t + off
        covariance = np.stack([np.diag([s**2, np.inf]) for s in claimed])
        bearings.append(
            Bearing(
                "a",
                "b",
                0.0,
                0.0,
                np.eye(4),
                unit_direction(azimuth, np.zeros(2)),
                covariance,
                np.array([0.9, 0.09]),
                0.01,
                1e5,
                300,
            )
        )
    return bearings, truth


def test_calibration_makes_held_out_claims_true():
    rng = np.random.default_rng(0)
    bearings, truth = claimed_and_true(rng, 400)
    calibration = fit_calibration(bearings, truth)
    assert calibration.sigma_scale == pytest.approx(3.0, rel=0.3)
    assert calibration.sigma_floor_rad == pytest.approx(0.02, rel=0.4)
    others, true = claimed_and_true(rng, 400)
    corrected = [calibration.applied(b) for b in others]
    levels = [azimuth_mixture(b).level_of(np.array([t]))[0] for b, t in zip(corrected, true, strict=True)]
    for level in (0.5, 0.68, 0.95):
        assert np.mean(np.array(levels) <= level) == pytest.approx(level, abs=0.06)
    assert mean_nll(corrected, true) < mean_nll(others, true) - 1


def test_honest_claims_are_left_nearly_alone():
    rng = np.random.default_rng(1)
    bearings, truth = claimed_and_true(rng, 400, sigma_factor=1.0, floor_rad=0.0, outlier_rate=0.01)
    calibration = fit_calibration(bearings, truth)
    assert calibration.sigma_scale == pytest.approx(1.0, rel=0.2)
    assert calibration.sigma_floor_rad < 0.004


def test_the_default_changes_nothing():
    bearings, _ = claimed_and_true(np.random.default_rng(2), 1)
    assert AzimuthCalibration().applied(bearings[0]) is bearings[0]


def test_probabilities_still_sum_to_one():
    bearings, _ = claimed_and_true(np.random.default_rng(2), 5)
    for b in [*bearings, replace(bearings[0], outlier_mass=0.0, weight=np.array([1.0, 0.0]))]:
        changed = AzimuthCalibration(2.0, 0.01, 0.5, 7.0).applied(b)
        assert changed.weight.sum() + changed.outlier_mass == pytest.approx(1.0)
        assert np.isinf(changed.tangent_covariance[:, 1, 1]).all()
        assert np.allclose(changed.tangent_covariance[:, 0, 1], 0.0)


def test_fitted_and_applied_likelihoods_agree():
    bearings, truth = claimed_and_true(np.random.default_rng(3), 30)
    calibration = AzimuthCalibration(2.0, 0.01, 0.5, 7.0)
    corrected = [calibration.applied(b) for b in bearings]
    one_by_one = [
        -azimuth_mixture(b).log_density(np.array([t]))[0] for b, t in zip(corrected, truth, strict=True)
    ]
    assert mean_nll(corrected, truth) == pytest.approx(np.mean(one_by_one))


def test_a_calibration_survives_its_file(tmp_path):
    calibration = AzimuthCalibration(2.0, 0.01, 0.5, 7.0)
    write_calibration(tmp_path / "c.json", calibration, {"source": "t265"})
    assert read_calibration(tmp_path / "c.json") == calibration


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{}", "format"),
        ('{"format": "mulan azimuth calibration 1", "sigma_scale": -1}', "sigma_scale"),
        ('{"format": "mulan azimuth calibration 1", "sigma_scale": 1}', "sigma_floor_rad"),
        ("[1", "JSON"),
    ],
)
def test_a_bad_calibration_file_is_named(tmp_path, text, said):
    (tmp_path / "c.json").write_text(text)
    with pytest.raises(InputError, match=said):
        read_calibration(tmp_path / "c.json")
