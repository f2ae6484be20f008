import numpy as np
import pytest

from mulan.geometry import se3, so3
from mulan.mission.types import OdometryTrack
from mulan.wireless.dead_reckoning import wheels_along_heading


def _arc(time_s, yaw_rad, radius_m):
    position = radius_m * np.stack([np.sin(yaw_rad), 1 - np.cos(yaw_rad), 0 * yaw_rad], 1)
    return OdometryTrack(time_s, se3.from_parts(so3.about_z(yaw_rad), position), None)


def test_wheel_steps_along_a_true_heading_give_the_antenna_path():
    time_s = np.linspace(0.0, 7.0, 400)
    yaw = np.pi * time_s / 7.0
    true = _arc(time_s, yaw, 0.15)
    slipping = _arc(time_s, 0.9 * yaw, 0.15 / 0.9)  # right step lengths, wrong turns
    blind = OdometryTrack(time_s, se3.from_parts(so3.about_z(yaw), np.zeros((400, 3))), None)
    lever_m = np.array([0.04, 0.16, 0.0])
    found = wheels_along_heading(blind, slipping, lever_m).T_odom_body[:, :3, 3]
    expected = true.T_odom_body[:, :3, :3] @ lever_m + true.T_odom_body[:, :3, 3]
    assert np.abs(found - expected).max() < 1e-4


def test_tracks_of_different_times_are_refused():
    time_s = np.linspace(0.0, 1.0, 10)
    track = _arc(time_s, time_s, 0.15)
    later = OdometryTrack(time_s + 5.0, track.T_odom_body, None)
    with pytest.raises(ValueError, match="share no time"):
        wheels_along_heading(track, later, np.zeros(3))
