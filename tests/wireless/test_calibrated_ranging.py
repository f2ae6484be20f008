from pathlib import Path

import numpy as np

from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import OdometryTrack, RangeTrack, RobotLog
from mulan.wireless.range_model import LinkError, RangeModel
from mulan.wireless.ranging import RangingConfig, thin_ranges

LAW = LinkError(0.2, 0.05, 0.1, 0.5, 0.01)


def _robot(name: str, ranges: dict[str, RangeTrack]) -> RobotLog:
    odometry = OdometryTrack(np.array([0.0, 10.0]), np.tile(np.eye(4), (2, 1, 1)), None)
    camera = PinholeCamera(12, 8, 15.0, 16.0, 6.5, 4.0)
    return RobotLog(name, camera, np.eye(4), np.zeros(3), np.zeros(3), (), odometry, {}, ranges)


def _thin(tmp_path: Path, correlation_s: float, outlier: bool = False):
    model = RangeModel((("alpha", "beta"),), (LAW, LAW), {}, 0.0, 5.0, 10.0, correlation_s)
    model.save(tmp_path / "model.json")
    time_s = np.arange(0, 10, 0.1)
    range_m = 4.2 + 0.05 * np.random.default_rng(0).normal(size=100) + 0.5 * time_s
    if outlier:
        range_m[::5] += 3
    track = RangeTrack("beta", time_s, range_m, np.full(100, 0.1))
    robots = [_robot("alpha", {"beta": track}), _robot("beta", {})]
    return thin_ranges(robots, RangingConfig(calibration=tmp_path / "model.json"))


def test_calibrated_ranges_are_free_of_bias_and_carry_the_laws_sigma(tmp_path: Path):
    ranges = _thin(tmp_path, 0.0)
    error = np.array([r.range_m - 4 - 0.5 * r.time_s for r in ranges])
    assert abs(error.mean()) < 0.02
    assert np.allclose([r.sigma_m for r in ranges], 0.05 / np.sqrt(5), rtol=0.2)
    assert ranges[0].outlier_mass == LAW.outlier_mass


def test_detours_are_left_out(tmp_path: Path):
    error = [r.range_m - 4 - 0.5 * r.time_s for r in _thin(tmp_path, 0.0, outlier=True)]
    assert np.abs(error).max() < 0.15


def test_lasting_errors_widen_sigma(tmp_path: Path):
    lasting = _thin(tmp_path, 8.0)
    assert np.isclose(sum(r.sigma_m**-2 for r in lasting) * 0.05**2, 10 / 8, rtol=0.01)
