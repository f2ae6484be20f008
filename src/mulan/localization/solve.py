"""Solving the graph with outliers: Huber first, then every measurement weighted by its probability."""

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.localization.factors import bearing_residual
from mulan.localization.graph import (
    LocalizationGraph,
    bearing_node_factor,
    observed_in_body,
    range_node_factor,
    sight_vector,
)

_INFLATION = (3.0, 1.0, 1.0, 1.0)  # wide at first: a poor start rejects nothing for good
_HUBER_SIGMAS = 1.345
_SETTLED = 0.02  # probabilities that change less need no further round
_LEAST_TRUST = 0.02  # below it a measurement is left out
_DETOUR_SPAN_M = 10.0  # wrong ranges are spread over so many metres


@dataclass(frozen=True)
class Solution:
    """The optimised graph.

    Attributes:
        values: Poses and biases.
        graph: With Gaussian noise scaled by the final probabilities; marginals come from it.
        bearing_inlier, range_inlier: Probability that each measurement was right.
        hypothesis: Which direction of each bearing was used.
        cost: Final graph error.
    """

    values: gtsam.Values
    graph: gtsam.NonlinearFactorGraph
    bearing_inlier: Float[NDArray, "m"]
    range_inlier: Float[NDArray, "r"]
    hypothesis: Int[NDArray, "m"]
    cost: float


def _optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(50)
    parameters.setRelativeErrorTol(1e-5)
    parameters.setAbsoluteErrorTol(1e-3)
    return gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()


def _bearing_trust(
    graph: LocalizationGraph, values: gtsam.Values, inflation: float
) -> tuple[Float[NDArray, "m"], Int[NDArray, "m"]]:
    """Posterior that any hypothesis of each bearing is right, and the likeliest hypothesis."""
    trust, chosen = np.zeros(len(graph.bearings)), np.zeros(len(graph.bearings), dtype=int)
    for i, node in enumerate(graph.bearings):
        v = sight_vector(values, node.sight)
        density = []
        for k, weight in enumerate(node.bearing.weight):
            u, basis, covariance = observed_in_body(node, k)
            covariance = covariance * inflation**2
            residual = bearing_residual(v, u, basis)[0]
            squared = float(residual @ np.linalg.solve(covariance, residual))
            norm = np.sqrt(np.linalg.det(2 * np.pi * covariance))
            density.append(weight * np.exp(-0.5 * squared) / norm)
        inside = float(np.sum(density))
        level = not np.isfinite(node.bearing.tangent_covariance[0, 1, 1])
        outside = 1 / (2 * np.pi) if level else 1 / (4 * np.pi)
        trust[i] = inside / (inside + node.bearing.outlier_mass * outside)
        chosen[i] = int(np.argmax(density)) if inside > 0 else 0
    return trust, chosen


def _range_trust(graph: LocalizationGraph, values: gtsam.Values, inflation: float) -> Float[NDArray, "r"]:
    mass = graph.config.range_outlier_mass
    trust = np.zeros(len(graph.ranges))
    for i, node in enumerate(graph.ranges):
        sigma = node.measurement.sigma_m * inflation
        predicted = np.linalg.norm(sight_vector(values, node.sight)) + values.atVector(node.bias_key)[0]
        z = (predicted - node.measurement.range_m) / sigma
        inside = (1 - mass) * np.exp(-0.5 * z**2) / (np.sqrt(2 * np.pi) * sigma)
        trust[i] = inside / (inside + mass / _DETOUR_SPAN_M)
    return trust


def _robust(noise: gtsam.noiseModel.Base) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(_HUBER_SIGMAS), noise)


def _weighted(
    graph: LocalizationGraph,
    bearing_trust: Float[NDArray, "m"],
    chosen: Int[NDArray, "m"],
    range_trust: Float[NDArray, "r"],
    inflation: float,
    robust: bool,
) -> gtsam.NonlinearFactorGraph:
    factors = graph.motion_factors()
    wrap = _robust if robust else (lambda noise: noise)
    for node, trust, k in zip(graph.bearings, bearing_trust, chosen, strict=True):
        if trust < _LEAST_TRUST:
            continue
        covariance = observed_in_body(node, int(k))[2] * inflation**2 / trust
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
        factors.add(bearing_node_factor(node, int(k), wrap(noise)))
    for node, trust in zip(graph.ranges, range_trust, strict=True):
        if trust < _LEAST_TRUST:
            continue
        noise = gtsam.noiseModel.Isotropic.Sigma(1, node.measurement.sigma_m * inflation / np.sqrt(trust))
        factors.add(range_node_factor(node, wrap(noise)))
    return factors


def solve_graph(
    graph: LocalizationGraph,
    initial: gtsam.Values,
    progress: Callable[[int, int, str], None] | None = None,
) -> Solution:
    """Most probable poses, and which measurements to believe.

    Expectation-maximisation over the bearings' mixtures and the ranges' outliers, sigmas inflated at first;
    each round is one Levenberg-Marquardt solve. A measurement's covariance is divided by its probability of
    being right, so that doubt also widens the marginals.
    """
    ones, chosen = np.ones(len(graph.bearings)), np.zeros(len(graph.bearings), dtype=int)
    trusted = np.ones(len(graph.ranges))
    factors = _weighted(graph, ones, chosen, trusted, _INFLATION[0], robust=True)
    values = _optimise(factors, initial)
    bearing_trust, range_trust = ones, trusted
    solved_with = _INFLATION[0]
    for done, inflation in enumerate(_INFLATION):
        if progress is not None:
            progress(done + 1, len(_INFLATION) + 1, "solving")
        before = np.concatenate([bearing_trust, range_trust])
        bearing_trust, chosen = _bearing_trust(graph, values, inflation)
        range_trust = _range_trust(graph, values, inflation)
        change = np.abs(np.concatenate([bearing_trust, range_trust]) - before).max(initial=0.0)
        if solved_with == inflation == _INFLATION[-1] and change < _SETTLED:
            break  # the last solve already had these sigmas and, nearly, these probabilities
        factors = _weighted(graph, bearing_trust, chosen, range_trust, inflation, robust=False)
        values = _optimise(factors, values)
        solved_with = inflation
    return Solution(values, factors, bearing_trust, range_trust, chosen, float(factors.error(values)))


def refine_solution(graph: LocalizationGraph, solution: Solution) -> Solution:
    """One more round from an earlier solution, after the graph's odometry changed a little."""
    bearing_trust, chosen = _bearing_trust(graph, solution.values, 1.0)
    range_trust = _range_trust(graph, solution.values, 1.0)
    factors = _weighted(graph, bearing_trust, chosen, range_trust, 1.0, robust=False)
    values = _optimise(factors, solution.values)
    return Solution(values, factors, bearing_trust, range_trust, chosen, float(factors.error(values)))
