import gtsam
import numpy as np

from mulan.localization.graph import LocalizationConfig, build_graph
from mulan.localization.graph_covariances import GraphCovariances
from mulan.localization.initialization import initial_alignment
from mulan.localization.solve import solve_graph

from .team import draw_measurements, make_team


def test_covariances_are_those_gtsam_finds_one_by_one():
    rng = np.random.default_rng(0)
    robots = make_team(rng, 3, n=30, photos=8)
    bearings, ranges = draw_measurements(rng, robots, bearings=4, ranges=8)
    config = LocalizationConfig()
    graph = build_graph(robots, bearings, ranges, config)
    start = initial_alignment(robots, bearings, ranges, config.initialization)
    solution = solve_graph(graph, graph.initial(start))
    theirs = gtsam.Marginals(solution.graph, solution.values)
    ours = GraphCovariances(solution.graph, solution.values)
    for name, frames in graph.robots.items():
        for i in range(len(frames.time_s)):
            key = graph.key(name, i)
            expected = theirs.marginalCovariance(key)
            np.testing.assert_allclose(ours.covariance(key), expected, rtol=1e-4, atol=1e-4 * expected.max())
    for keys in (
        [graph.key("beta", 3), graph.key("beta", 4)],
        [graph.key("alpha", 2), graph.key("gamma", 5)],
    ):
        found = theirs.jointMarginalCovariance(gtsam.KeyVector(keys))
        expected = np.block([[found.at(a, b) for b in keys] for a in keys])
        np.testing.assert_allclose(ours.joint(keys), expected, rtol=1e-4, atol=1e-4 * expected.max())
