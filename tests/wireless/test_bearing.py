from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.mission.types import RangeTrack
from mulan.wireless.bearing import BearingConfig, KeepProfile, estimate_bearings
from mulan.wireless.directions import tangent_basis
from mulan.wireless.ranging import RangingConfig, thin_ranges

from .signals import two_robots


def true_direction(bearing, T_ab):
    """From the centroid of the observer's antenna path to the peer's resting antenna."""
    T = T_ab if bearing.observer == "alpha" else se3.inverse(T_ab)
    v = T[:3, :3] @ np.array([0.1, 0.0, 0.05]) + T[:3, 3] - bearing.origin_odom_m
    return v / np.linalg.norm(v)


def test_both_directions_are_measured_within_their_sigma():
    robots, T_ab = two_robots(np.random.default_rng(0))
    bearings = estimate_bearings(robots, BearingConfig(keep_profile=KeepProfile.ONE))
    assert [(b.observer, b.peer) for b in bearings] == [("alpha", "beta"), ("beta", "alpha")]
    for bearing in bearings:
        u, true = bearing.direction_odom[0], true_direction(bearing, T_ab)
        error = tangent_basis(u).T @ (true - u)
        nees = error @ np.linalg.solve(bearing.tangent_covariance[0], error)
        assert nees < 12
        assert np.degrees(np.linalg.norm(error)) < 1.0
        assert bearing.weight.sum() + bearing.outlier_mass == pytest.approx(1.0)
        assert bearing.peer_time_s - bearing.time_s == pytest.approx(
            7.5 if bearing.observer == "alpha" else -7.5
        )
        assert bearing.packets > 300
    assert sum(b.profile is not None for b in bearings) == 1


def test_level_apertures_report_azimuth_only():
    robots, T_ab = two_robots(np.random.default_rng(1), peer_world_m=(3.0, 2.0, 0.0), level=True)
    for bearing in estimate_bearings(robots, BearingConfig()):
        true = true_direction(bearing, T_ab)
        u = bearing.direction_odom[0]
        assert np.isinf(bearing.tangent_covariance[0, 1, 1])
        assert abs(np.degrees(np.arctan2(np.cross(u, true)[2], u[:2] @ true[:2]))) < 1.0


def test_an_observer_gets_no_bearing_to_a_moving_peer():
    (alpha, beta), _ = two_robots(np.random.default_rng(2))
    T = beta.odometry.T_odom_body.copy()
    T[:, 0, 3] += 0.3 * (beta.odometry.time_s - 7.5)
    restless = replace(beta, odometry=replace(beta.odometry, T_odom_body=T))
    assert [b.observer for b in estimate_bearings((alpha, restless), BearingConfig())] == ["beta"]


def test_a_peer_outside_the_mission_is_refused():
    (alpha, _), _ = two_robots(np.random.default_rng(3))
    with pytest.raises(InputError, match="no robot of this mission"):
        estimate_bearings((alpha,), BearingConfig())


def test_progress_reaches_the_end():
    robots, _ = two_robots(np.random.default_rng(4))
    calls = []
    estimate_bearings(robots, BearingConfig(), lambda done, total, text: calls.append((done, total)))
    assert calls[-1] == (2, 2)


def test_thinning_votes_outliers_down_and_follows_motion():
    (alpha, beta), _ = two_robots(np.random.default_rng(5))
    rng = np.random.default_rng(6)
    time_s = np.arange(0, 20, 0.05)
    true_m = 4 + 0.5 * time_s
    measured = true_m + 0.05 * rng.normal(size=len(time_s))
    measured[::9] += 3.0
    measured[5] = np.nan
    track = RangeTrack("beta", time_s, measured, np.full(len(time_s), 0.05))
    thinned = thin_ranges((replace(alpha, ranges={"beta": track}), beta), RangingConfig(rate_hz=1.0))
    assert len(thinned) == 20
    error = np.array([r.range_m - (4 + 0.5 * r.time_s) for r in thinned])
    assert np.abs(error).max() < 0.1
    assert all(0.02 <= r.sigma_m < 0.05 for r in thinned)


def test_ranges_without_sigma_are_refused():
    (alpha, beta), _ = two_robots(np.random.default_rng(7))
    track = replace(alpha.ranges["beta"], sigma_m=np.zeros(len(alpha.ranges["beta"].time_s)))
    with pytest.raises(InputError, match="sigma"):
        thin_ranges((replace(alpha, ranges={"beta": track}), beta), RangingConfig())
