from dataclasses import replace

import numpy as np

from mulan.geometry import se3, so3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize
from mulan.mission.types import Mission, Photo
from mulan.wireless.bearing import BearingConfig

from .signals import two_robots


def test_raw_csi_and_ranges_place_two_robots_on_different_clocks_in_one_frame():
    robots, T_ab = two_robots(np.random.default_rng(20))
    with_photos = [
        replace(log, photos=tuple(Photo(float(t), "png", b"") for t in log.odometry.time_s[::60]))
        for log in robots
    ]
    calls = []
    localization = localize(
        Mission(tuple(with_photos)),
        LocalizationConfig(),
        BearingConfig(),
        lambda done, total, text: calls.append(text),
    )
    beta = localization.trajectories["beta"]
    odometry = with_photos[1].odometry
    true = T_ab @ se3.interpolate(odometry.time_s, odometry.T_odom_body, beta.time_s)
    assert np.abs(beta.T_world_body[:, :3, 3] - true[:, :3, 3]).max() < 0.15
    turn = so3.log(np.swapaxes(true[:, :3, :3], 1, 2) @ beta.T_world_body[:, :3, :3])
    assert np.degrees(np.abs(turn)).max() < 2.0
    assert (localization.bearing_inlier > 0.9).all()
    xi = se3.log(se3.inverse(beta.T_world_body) @ true)
    assert np.einsum("ni,nij,nj->n", xi, np.linalg.inv(beta.covariance), xi).mean() / 6 < 2.5
    assert calls
