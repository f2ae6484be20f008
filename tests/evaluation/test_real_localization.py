"""Real flights, real bearings and real ranges: what the evaluation draws, solves and scores."""

import os
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.evaluation.localization.bearing_resection import ResectionConfig, SeenRadio, resection
from mulan.evaluation.localization.flights import (
    on_estimators_body,
    read_flight,
    read_tum,
    turned_about_vertical,
)
from mulan.evaluation.localization.real_uwb import run_uwb_indoor_chemnitz
from mulan.evaluation.localization.relative_score import figures, relative_errors
from mulan.evaluation.localization.uwb_murp_track import antenna_places, read_pair
from mulan.geometry import se3, so3
from mulan.wireless.azimuth_density import AzimuthMixture
from mulan.wireless.recordings.uwb_murp import murp_files

DATA = Path(os.environ.get("MULAN_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings in {DATA}; set MULAN_DATA")
RADIOS_M = np.array([[2.5, -2.6], [-2.4, 2.6], [-3.7, -1.5]])


def _seen(at_m, sigma_rad, noise_rad):
    return [
        SeenRadio(
            AzimuthMixture(
                np.array([np.arctan2(*(radio - at_m)[::-1]) + off]),
                np.array([sigma_rad]),
                np.array([0.95]),
                0.05,
            ),
            np.zeros(2),
            radio,
        )
        for radio, off in zip(RADIOS_M, noise_rad, strict=True)
    ]


def test_resection_finds_the_place_the_bearings_meet():
    at = np.array([0.4, -0.3])
    posterior = resection(_seen(at, 0.02, np.zeros(3)), 0.005, ResectionConfig(farthest_m=6.0, cell_m=0.1))
    assert np.linalg.norm(posterior.nearest_m - at) < 0.1


def test_resection_covers_as_claimed():
    rng = np.random.default_rng(1)
    config = ResectionConfig(farthest_m=6.0, cell_m=0.15)
    levels = []
    for _ in range(60):
        at, sigma = rng.uniform(-0.8, 0.8, 2), 0.15
        posterior = resection(_seen(at, sigma, sigma * rng.normal(size=3)), 0.001, config)
        levels.append((posterior.level_of(at), posterior.ellipse_level_of(at)))
    for claimed in np.array(levels).T:
        assert 0.5 <= np.mean(claimed <= 0.68) <= 0.85
        assert np.mean(claimed <= 0.95) >= 0.88


def test_the_ellipse_of_a_share_holds_it_and_its_edge_has_that_level():
    posterior = resection(
        _seen(np.array([0.4, -0.3]), 0.2, np.zeros(3)), 0.005, ResectionConfig(farthest_m=6.0)
    )
    Q = posterior.ellipse_m2(0.68)
    off = posterior.place_m - posterior.nearest_m
    inside = np.einsum("ni,ij,nj->n", off, np.linalg.inv(Q), off) < 1
    assert posterior.mass[inside].sum() == pytest.approx(0.68, abs=0.01)
    edge = posterior.nearest_m + np.linalg.cholesky(Q) @ np.array([1.0, 0.0])
    assert posterior.ellipse_level_of(edge) == pytest.approx(0.68, abs=0.01)


def test_relative_error_does_not_depend_on_the_world_frame():
    rng = np.random.default_rng(2)
    T = [se3.exp(rng.normal(size=(5, 6))) for _ in range(2)]
    moved = se3.exp(rng.normal(size=6))
    errors = relative_errors(("a", "b"), np.arange(5.0), (moved @ T[0], moved @ T[1]), (T[0], T[1]))
    assert figures([errors])["rms_m"] < 1e-9


def test_yaw_error_is_the_turn_about_the_vertical():
    level = np.tile(np.eye(4), (3, 1, 1))
    turned = se3.from_parts(so3.about_z(np.full(3, 0.1)), np.zeros((3, 3)))
    errors = relative_errors(("a", "b"), np.arange(3.0), (level, turned), (level, level))
    assert errors.yaw_rad == pytest.approx(np.full(3, 0.1))


def test_a_damaged_flight_is_told(tmp_path):
    path = tmp_path / "groundtruth.txt"
    path.write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 2\n")
    with pytest.raises(InputError, match="quaternion"):
        read_tum(path)


@needs_data
def test_flight_is_laid_on_its_truth_within_its_known_drift():
    flight, turn = on_estimators_body(read_flight(DATA / "euroc_vio" / "MH_03", "vio_mono"))
    begin, end = flight.span_s
    own = flight.odometry
    inside = (own.time_s >= begin) & (own.time_s <= end)
    at = own.T_odom_body[inside, :3, 3]
    true = se3.interpolate(flight.truth.time_s, flight.truth.T_world_body, own.time_s[inside])[:, :3, 3]
    T = turned_about_vertical(at, true)
    off = np.linalg.norm(at @ T[:3, :3].T + T[:3, 3] - true, axis=1)
    assert np.sqrt((off**2).mean()) < 0.3
    assert np.abs(turn).max() < np.deg2rad(5)


@needs_data
def test_murps_antennas_are_recovered_from_the_agents_own_motion_capture():
    files = murp_files(DATA / "uwb_murp")
    places, misfit_m = antenna_places([read_pair(path) for path in files["12"]])
    assert misfit_m < 0.01
    radius = np.linalg.norm(np.array(list(places.values()))[:, :2], axis=1)
    np.testing.assert_allclose(radius, 0.32, atol=0.01)


@needs_data
def test_indoor_track_is_better_with_calibrated_ranges():
    result = run_uwb_indoor_chemnitz(DATA)
    assert result["rms_m"] < result["uncalibrated"]["rms_m"]
    assert result["rms_m"] < 0.15
