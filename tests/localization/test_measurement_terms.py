from dataclasses import replace

import gtsam
import numpy as np
import pytest

from mulan.localization.graph import LocalizationConfig, bearing_node_factor, build_graph, range_node_factor
from mulan.localization.initialization import initial_alignment
from mulan.localization.least_squares import Problem, minimise
from mulan.localization.measurement_terms import huber, measurement_terms, quadratic

from .team import draw_measurements, make_team


def small_graph(seed=0, level=False):
    rng = np.random.default_rng(seed)
    robots = make_team(rng, 3, n=30, photos=8)
    bearings, ranges = draw_measurements(rng, robots, bearings=4, ranges=8, level=level)
    config = LocalizationConfig(common_floor_sigma_m=0.3 if level else None)
    start = initial_alignment(
        robots, bearings, ranges, config.initialization, True, config.common_floor_sigma_m
    )
    graph = build_graph(robots, bearings, ranges, config)
    return graph, graph.initial(start)


def custom_factors(graph):
    """The same measurements as factors gtsam calls one by one."""
    factors = graph.motion_factors()
    for node in graph.bearings:
        covariance = node.bearing.tangent_covariance[0]
        seen = np.isfinite(np.diag(covariance))
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance[np.ix_(seen, seen)])
        factors.add(bearing_node_factor(node, 0, noise))
    for node in graph.ranges:
        noise = gtsam.noiseModel.Isotropic.Sigma(1, node.measurement.sigma_m)
        factors.add(range_node_factor(node, noise))
    return factors


def plain(graph, inflation=1.0, kernel=quadratic):
    terms = measurement_terms(graph)
    chosen, trust = np.zeros(len(terms.direction), dtype=int), np.ones(len(terms.observer))
    return Problem(graph.motion_factors(), terms, chosen, trust, inflation, kernel)


@pytest.mark.parametrize("level", [False, True])
def test_terms_cost_what_the_factors_cost(level):
    graph, values = small_graph(level=level)
    assert plain(graph).cost(values) == pytest.approx(custom_factors(graph).error(values), rel=1e-9)


@pytest.mark.parametrize("level", [False, True])
def test_terms_have_the_normal_equations_of_the_factors(level):
    graph, values = small_graph(1, level)
    problem = plain(graph)
    ours, cost = problem.linear(values)
    theirs = custom_factors(graph).linearize(values)
    assert cost == pytest.approx(problem.cost(values))
    ordering = gtsam.Ordering.ColamdGaussianFactorGraph(theirs)
    for one, other in zip(ours.hessian(ordering), theirs.hessian(ordering), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-5 * np.abs(other).max())


def test_the_minimum_is_the_one_gtsam_finds():
    graph, values = small_graph(2)
    factors = custom_factors(graph)
    theirs = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    ours = minimise(plain(graph), values)
    assert factors.error(ours) == pytest.approx(factors.error(theirs), abs=1e-2)


def test_damping_recovers_from_a_poor_start():
    graph, values = small_graph(3)
    best = minimise(plain(graph), values)
    rng = np.random.default_rng(0)
    moved = {key: 0.5 * rng.normal(size=6) * [0, 0, 1, 1, 1, 1] for key in measurement_terms(graph).pose_keys}
    poor = gtsam.Values(values)
    for key, xi in moved.items():
        poor.update(key, values.atPose3(key).retract(xi))
    problem = plain(graph)
    assert problem.cost(minimise(problem, poor)) == pytest.approx(problem.cost(best), abs=1e-1)


def test_huber_lets_one_wrong_range_pull_less():
    graph, values = small_graph(4)
    node = graph.ranges[0]
    wrong = replace(node, measurement=replace(node.measurement, range_m=node.measurement.range_m + 30))
    spoilt = replace(graph, ranges=(wrong, *graph.ranges[1:]))
    true = minimise(plain(graph), values)

    def moved(kernel):
        found = minimise(plain(spoilt, kernel=kernel), values)
        return max(
            np.linalg.norm(found.atPose3(key).translation() - true.atPose3(key).translation())
            for key in measurement_terms(graph).pose_keys
        )

    assert moved(huber) < 0.3 * moved(quadratic)
