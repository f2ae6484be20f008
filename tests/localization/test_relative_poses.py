import json

import numpy as np

from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize_from_measurements
from mulan.localization.run_files import write_localization
from mulan.mission.run_folder import RunFolder
from mulan.mission.types import Mission

from .team import draw_measurements, make_team


def solved(seed, count=3):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, count, n=30, photos=5)
    bearings, ranges = draw_measurements(rng, robots, bearings=5, ranges=10)
    return robots, localize_from_measurements(robots, bearings, ranges, LocalizationConfig())


def true_relative(robots, pose):
    ends = []
    for name, time_s in ((pose.robot, pose.time_s), (pose.peer, pose.peer_time_s)):
        truth = next(r.ground_truth for r in robots if r.name == name)
        ends.append(se3.interpolate(truth.time_s, truth.T_world_body, np.array([time_s]))[0])
    return se3.inverse(ends[0]) @ ends[1]


def test_relative_covariances_are_honest():
    nees = []
    for seed in range(8):
        robots, found = solved(50 + seed, 2)
        for pose in found.relative_poses:
            xi = se3.log(se3.inverse(pose.T_robot_peer) @ true_relative(robots, pose))
            nees.append(xi @ np.linalg.solve(pose.covariance, xi) / 6)
    assert 0.6 < np.mean(nees) < 1.5


def test_what_two_robots_share_cancels_in_their_relative_pose():
    # far from the anchor's start both share the drift of the frame they were placed in
    _, found = solved(60)
    late = [p for p in found.relative_poses if (p.robot, p.peer) == ("beta", "gamma")][-1]
    ends = [found.trajectories[name] for name in ("beta", "gamma")]
    by_beta = se3.adjoint(se3.inverse(se3.inverse(ends[0].T_world_body[-1]) @ ends[1].T_world_body[-1]))
    as_if_independent = by_beta @ ends[0].covariance[-1] @ by_beta.T + ends[1].covariance[-1]
    assert late.covariance[3:, 3:].trace() < as_if_independent[3:, 3:].trace()
    assert np.linalg.eigvalsh(late.covariance).min() > 0


def test_relative_poses_are_written(tmp_path):
    robots, found = solved(61, 2)
    write_localization(found, Mission(robots), RunFolder(tmp_path))
    record = json.loads((tmp_path / "relative_poses.json").read_text())
    assert len(record) == 5
    assert np.shape(record[-1]["covariance"]) == (6, 6)
    np.testing.assert_allclose(
        record[-1]["T_robot_peer"], true_relative(robots, found.relative_poses[-1]), atol=0.5
    )
    assert (tmp_path / "localization.png").stat().st_size > 10_000
