from dataclasses import replace

import numpy as np

from mulan.geometry import se3
from mulan.localization.accuracy import accuracy
from mulan.localization.graph import LocalizationConfig, build_graph
from mulan.localization.localize import localize_from_measurements
from mulan.mission.types import Mission

from .team import draw_measurements, make_team

SPARSE = replace(LocalizationConfig(), photo_keyframe_every_m=1.0, photo_keyframe_every_s=15.0)


def both_ways(seed, **team):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, n=101, photos=101, **team)
    bearings, ranges = draw_measurements(rng, robots, bearings=8, ranges=20)
    dense = localize_from_measurements(robots, bearings, ranges, LocalizationConfig())
    sparse = localize_from_measurements(robots, bearings, ranges, SPARSE)
    return robots, bearings, ranges, dense, sparse


def test_interpolated_poses_and_covariances_are_those_of_a_graph_with_every_photograph():
    robots, bearings, ranges, dense, sparse = both_ways(30)
    fewer = [
        len(build_graph(robots, bearings, ranges, c).robots["beta"].time_s)
        for c in (SPARSE, LocalizationConfig())
    ]
    assert fewer[0] < 0.5 * fewer[1]
    for name in ("alpha", "beta"):
        all_poses, few = dense.trajectories[name], sparse.trajectories[name]
        sigma = np.sqrt(np.einsum("nii->ni", all_poses.covariance))
        apart = se3.log(se3.inverse(all_poses.T_world_body) @ few.T_world_body)[5:]
        assert (np.abs(apart) / sigma[5:]).max() < 0.5
        ratio = np.sqrt(np.einsum("nii->ni", few.covariance))[5:] / sigma[5:]
        assert ratio.min() > 0.9
        assert ratio.max() < 1.35
        assert np.linalg.eigvalsh(few.covariance).min() > 0


def test_interpolated_covariances_are_honest():
    nees = []
    for seed in range(6):
        robots, _, _, _, sparse = both_ways(40 + seed)
        result = accuracy(sparse, Mission(robots))
        nees += [r.nees_per_dof for r in result.values()]
    assert 0.5 < np.mean(nees) < 1.5


def test_a_pose_at_a_keyframe_is_the_keyframe():
    _, _, _, dense, sparse = both_ways(31)
    first = sparse.trajectories["beta"]
    assert np.linalg.norm(first.T_world_body[0] - dense.trajectories["beta"].T_world_body[0]) < 0.05
