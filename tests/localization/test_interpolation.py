from dataclasses import replace

import numpy as np

from mulan.geometry import se3
from mulan.localization.accuracy import accuracy
from mulan.localization.graph import LocalizationConfig, build_graph
from mulan.localization.localize import localize_from_measurements
from mulan.mission.types import Mission

from .team import draw_measurements, make_team

SPARSE = replace(LocalizationConfig(), photo_keyframe_every_m=1.0, photo_keyframe_every_s=15.0)


def measured(seed):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, n=51, photos=51)
    return robots, *draw_measurements(rng, robots, bearings=5, ranges=10)


def test_interpolated_poses_and_covariances_are_those_of_a_graph_with_every_photograph():
    team = measured(30)
    dense, sparse = (localize_from_measurements(*team, config) for config in (LocalizationConfig(), SPARSE))
    few, many = (len(build_graph(*team, c).robots["beta"].time_s) for c in (SPARSE, LocalizationConfig()))
    assert few < 0.6 * many
    for name in ("alpha", "beta"):
        expected, found = dense.trajectories[name], sparse.trajectories[name]
        sigma = np.sqrt(np.einsum("nii->ni", expected.covariance))[1:]
        apart = se3.log(se3.inverse(expected.T_world_body) @ found.T_world_body)[1:]
        assert (np.abs(apart) / sigma).max() < 0.5
        ratio = np.sqrt(np.einsum("nii->ni", found.covariance))[1:] / sigma
        assert ratio[:, 2:].min() > 0.95
        assert ratio[:, 2:].max() < 1.05
        # roll and pitch: fewer steps add fewer floors, fewer keyframes average the vertical less
        assert ratio.min() > 0.7
        assert ratio.max() < 1.3
        assert np.linalg.eigvalsh(found.covariance).min() > 0


def test_interpolated_covariances_are_honest():
    nees = []
    for seed in range(3):
        team = measured(40 + seed)
        result = accuracy(localize_from_measurements(*team, SPARSE), Mission(team[0]))
        assert result is not None
        nees += [r.nees_per_dof for r in result.values()]
    assert 0.4 < np.mean(nees) < 1.5
