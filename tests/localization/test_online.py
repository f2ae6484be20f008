from dataclasses import replace

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.online import OnlineConfig, OnlineLocalization
from mulan.localization.online_batch import solve_batch

from .team import draw_bearing, draw_measurements, make_team

N = 60


def radio(rng, robots, every=6):
    """Bearings in both directions and a range of every pair, by keyframe index."""
    bearings, ranges = draw_measurements(rng, robots, bearings=N // every, ranges=N // every)
    by_index = {}
    for m in (*bearings, *ranges):
        i = int(np.abs(robots[0].odometry.time_s - m.time_s).argmin())
        by_index.setdefault(i, []).append(m)
    return by_index


def keyframe(online, robot, i):
    track = robot.odometry
    online.add_keyframe(robot.name, float(track.time_s[i]), track.T_odom_body[i], track.covariance[i])


def send(online, m):
    (online.add_bearing if hasattr(m, "tangent_covariance") else online.add_range)(m)


def play(online, robots, by_index, active=lambda name, i: True, announce=lambda name: 0):
    estimates = []
    for i in range(N):
        for robot in robots:
            if i == announce(robot.name):
                online.add_robot(robot)
            if i >= announce(robot.name) and active(robot.name, i):
                keyframe(online, robot, i)
        for m in by_index.get(i, []):
            if all(i >= announce(name) and active(name, i) for name in (m.observer, m.peer)):
                send(online, m)
        estimates.append(online.update())
    return estimates


def relative_error(estimate, robots, i, names=("alpha", "beta")):
    first, second = names
    truth = {r.name: r.ground_truth.T_world_body[i] for r in robots}
    true = se3.inverse(truth[first]) @ truth[second]
    seen = se3.inverse(estimate.T_world_body[first]) @ estimate.T_world_body[second]
    return se3.log(se3.inverse(seen) @ true), estimate.relative_covariance(first, second)


def test_the_end_equals_the_batch_solution():
    rng = np.random.default_rng(0)
    robots = make_team(rng, 3, n=N)
    online = OnlineLocalization()
    estimate = play(online, robots, radio(rng, robots))[-1]
    assert not estimate.waiting
    _, batch = solve_batch(online)
    online_poses = online.trajectories()
    for name, poses in batch.items():
        assert len(poses) == N
        np.testing.assert_allclose(estimate.T_world_body[name], online_poses[name][-1], atol=1e-9)
        assert np.linalg.norm(poses[-1, :3, 3] - estimate.T_world_body[name][:3, 3]) < 0.01
        turn = se3.log(se3.inverse(poses[-1]) @ estimate.T_world_body[name])[:3]
        assert np.degrees(np.linalg.norm(turn)) < 0.3


def test_with_the_whole_mission_in_the_window_every_pose_equals_the_batch_solution():
    rng = np.random.default_rng(1)
    robots = make_team(rng, 2, n=N)
    online = OnlineLocalization(OnlineConfig(horizon_s=1e4))
    play(online, robots, radio(rng, robots))
    _, batch = solve_batch(online)
    for name, poses in online.trajectories().items():
        np.testing.assert_allclose(poses[:, :3, 3], batch[name][:, :3, 3], atol=5e-3)


def test_covariances_of_newest_poses_are_true():
    nees = []
    for seed in range(2):
        rng = np.random.default_rng(10 + seed)
        robots = make_team(rng, 2, n=N)
        for i, estimate in enumerate(play(OnlineLocalization(), robots, radio(rng, robots))):
            if i >= 30 and i % 6 == 0:
                xi, covariance = relative_error(estimate, robots, i)
                # the simulated odometry is level: roll and pitch have no error
                nees.append(xi[2:] @ np.linalg.solve(covariance[2:, 2:], xi[2:]) / 4)
    assert 0.4 < np.mean(nees) < 1.9


def test_a_late_robot_waits_with_its_reason_and_then_joins():
    rng = np.random.default_rng(2)
    robots = make_team(rng, 3, n=N)
    by_index = radio(rng, robots)
    online = OnlineLocalization()
    estimates = play(online, robots, by_index, announce=lambda name: 30 if name == "gamma" else 0)
    assert estimates[30].waiting.keys() == {"gamma"}
    assert "no bearings" in estimates[30].waiting["gamma"]
    assert not estimates[-1].waiting
    assert np.linalg.norm(relative_error(estimates[-1], robots, N - 1, ("alpha", "gamma"))[0][3:]) < 0.5
    assert len(online.trajectories()["gamma"]) == N - 30


@pytest.mark.parametrize("lost_m", [1e9, 0.0])
def test_a_robot_that_vanishes_returns_and_disturbs_nobody(lost_m):
    """Going on from its odometry, or, where that may have drifted too far, aligned anew."""
    rng = np.random.default_rng(3)
    robots = make_team(rng, 3, n=N)
    by_index = radio(rng, robots)
    config = OnlineConfig(silent_updates=5, lost_m=1e9 if lost_m else 0.02)
    online = OnlineLocalization(config)

    def active(name, i):
        return name != "beta" or not 20 <= i < 40

    estimates = play(online, robots, by_index, active)
    assert "beta" not in estimates[35].names
    assert estimates[35].time_s["beta"] == robots[1].odometry.time_s[19]
    assert ("beta" in estimates[40].waiting) == (not lost_m)
    assert set(estimates[-1].names) == {"alpha", "beta", "gamma"}
    for other in ("beta", "gamma"):
        assert np.linalg.norm(relative_error(estimates[-1], robots, N - 1, ("alpha", other))[0][3:]) < 0.5


def test_the_window_stays_small():
    rng = np.random.default_rng(4)
    robots = make_team(rng, 2, n=N)
    online = OnlineLocalization(OnlineConfig(horizon_s=20.0))
    play(online, robots, radio(rng, robots))
    assert online.window_keyframes <= 2 * 22


def test_wrong_bearings_are_not_believed():
    rng = np.random.default_rng(5)
    robots = make_team(rng, 2, n=N)
    by_index = radio(rng, robots)
    for i in range(20, N, 7):
        by_index.setdefault(i, []).append(draw_bearing(rng, robots[0], robots[1], i, 0.03, outlier=True))
    estimates = play(OnlineLocalization(), robots, by_index)
    errors = [np.linalg.norm(relative_error(estimates[i], robots, i)[0][3:]) for i in range(35, N)]
    assert max(errors) < 0.5


def test_measurements_that_come_before_their_keyframes_are_held_and_of_gaps_dropped():
    rng = np.random.default_rng(6)
    robots = make_team(rng, 2, n=N)
    online = OnlineLocalization()
    play(online, robots, radio(rng, robots))
    early = draw_bearing(rng, robots[0], robots[1], N - 1, 0.03)
    online.add_bearing(replace(early, time_s=early.time_s + 5.0, peer_time_s=early.peer_time_s + 5.0))
    online.update()
    assert online.dropped == 0
    for robot in robots:
        T, covariance = robot.odometry.T_odom_body[-1], robot.odometry.covariance[-1]
        online.add_keyframe(robot.name, float(robot.odometry.time_s[-1]) + 30.0, T, covariance)
    online.update()
    assert online.dropped == 1


def test_bad_messages_are_refused_with_a_sentence():
    rng = np.random.default_rng(7)
    robots = make_team(rng, 2, n=N)
    online = OnlineLocalization()
    online.add_robot(robots[0])
    with pytest.raises(InputError, match="already"):
        online.add_robot(robots[0])
    with pytest.raises(InputError, match="unknown"):
        online.add_bearing(draw_bearing(rng, robots[0], robots[1], 5, 0.03))
    keyframe(online, robots[0], 5)
    with pytest.raises(InputError, match="order of time"):
        keyframe(online, robots[0], 4)
    with pytest.raises(InputError, match="finite"):
        online.add_keyframe("alpha", 1e3, np.full((4, 4), np.nan))
