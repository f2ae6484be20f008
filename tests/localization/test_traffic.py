from dataclasses import replace

import numpy as np

from mulan.localization.traffic import decode_bearing, encode_bearing, pair_traffic
from mulan.mission.types import RangeTrack

from .team import draw_bearing, make_team


def test_a_bearing_survives_its_message():
    rng = np.random.default_rng(0)
    robots = make_team(rng, 2)
    bearing = draw_bearing(rng, robots[0], robots[1], 5, 0.03, level=True)
    bearing = replace(bearing, origin_odom_m=np.array([0.1, 0.2, 0.3]))
    back = decode_bearing(encode_bearing(bearing))
    for name, value in vars(bearing).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_allclose(getattr(back, name), value, atol=1e-12)
        elif isinstance(value, float):
            np.testing.assert_allclose(getattr(back, name), value, atol=1e-9)
        else:
            assert getattr(back, name) == value


def test_coordination_of_a_pair_stays_within_five_kilobytes_a_second():
    """Keyframes and ranges at 1 and 2 Hz, and an aperture in each direction every ten seconds."""
    rng = np.random.default_rng(1)
    robots = list(make_team(rng, 3))
    for k, robot in enumerate(robots):
        time_s = np.arange(0.0, 100.0, 0.5)
        ranges = {
            p.name: RangeTrack(p.name, time_s, 2 + 0 * time_s, 0.05 + 0 * time_s) for p in robots[k + 1 :]
        }
        robots[k] = replace(robot, ranges=ranges)
    bearings = [
        draw_bearing(rng, a, b, i, 0.03)
        for a in robots
        for b in robots
        for i in range(0, 100, 10)
        if a is not b
    ]
    traffic = pair_traffic(robots, bearings)
    assert len(traffic) == 3
    for pair in traffic.values():
        assert pair.range_bytes > 200 * 30
        assert pair.bearing_bytes > 20 * 150
        assert 500 < pair.bytes_per_s < 5000


def test_odometry_of_a_high_rate_is_sent_as_keyframes():
    robots = make_team(np.random.default_rng(2), 2, n=400)
    (fine,) = pair_traffic(robots, []).values()
    (coarse,) = pair_traffic(robots, [], keyframe_s=2.0).values()
    assert 1.8 < fine.odometry_bytes / coarse.odometry_bytes < 2.2
