"""Solving the graph with outliers: Huber first, then every measurement weighted by its probability."""

from collections.abc import Callable
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.localization.graph import (
    LocalizationGraph,
    bearing_node_factor,
    observed_in_body,
    range_node_factor,
)
from mulan.localization.least_squares import Problem, minimise
from mulan.localization.measurement_terms import MeasurementTerms, huber, measurement_terms, quadratic

_INFLATION = (3.0, 1.0, 1.0, 1.0)  # wide at first: a poor start rejects nothing for good
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


def _trust(
    terms: MeasurementTerms, values: gtsam.Values, inflation: float
) -> tuple[Float[NDArray, "m"], Int[NDArray, "b"]]:
    """Posterior that each measurement (any hypothesis of a bearing) is right; the likeliest one."""
    poses, b = terms.poses(values), len(terms.direction)
    v = terms.sight(poses)[0]
    miss = terms.bearing_misses(v[:b])
    squared = (miss * np.linalg.solve(terms.covariance, miss[..., None])[..., 0]).sum(-1) / inflation**2
    # an axis that was not observed has variance one and no miss: it adds nothing but must not be normalised
    spread = np.linalg.slogdet(terms.covariance)[1] + terms.axes[:, None] * np.log(2 * np.pi * inflation**2)
    inside = terms.log_weight - squared / 2 - spread / 2
    chosen = inside.argmax(1) if b else np.zeros(0, dtype=int)
    sphere = np.where(terms.axes == 1, 2 * np.pi, 4 * np.pi)
    sigma = terms.sigma_m * inflation
    mass = terms.outlier_mass
    log_right = np.concatenate(
        [
            np.logaddexp.reduce(inside, axis=1) if b else np.zeros(0),
            np.log1p(-mass[b:])
            - (terms.range_misses(v[b:], poses) / sigma) ** 2 / 2
            - np.log(np.sqrt(2 * np.pi) * sigma),
        ]
    )
    log_wrong = np.log(np.maximum(mass, 1e-300)) - np.log(
        np.concatenate([sphere, np.full(len(sigma), _DETOUR_SPAN_M)])
    )
    return np.exp(log_right - np.logaddexp(log_right, log_wrong)), chosen


def _weighted(
    graph: LocalizationGraph,
    motion: gtsam.NonlinearFactorGraph,
    trust: Float[NDArray, "m"],
    chosen: Int[NDArray, "b"],
) -> gtsam.NonlinearFactorGraph:
    """The motion and every believed measurement, its covariance divided by its trust."""
    factors = motion.clone()
    for node, believed, k in zip(graph.bearings, trust, chosen, strict=False):
        if believed >= _LEAST_TRUST:
            noise = gtsam.noiseModel.Gaussian.Covariance(observed_in_body(node, int(k))[2] / believed)
            factors.add(bearing_node_factor(node, int(k), noise))
    for node, believed in zip(graph.ranges, trust[len(graph.bearings) :], strict=True):
        if believed >= _LEAST_TRUST:
            noise = gtsam.noiseModel.Isotropic.Sigma(1, node.measurement.sigma_m / np.sqrt(believed))
            factors.add(range_node_factor(node, noise))
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
    terms, motion = measurement_terms(graph), graph.motion_factors()
    trust, chosen = np.ones(len(terms.observer)), np.zeros(len(terms.direction), dtype=int)
    values = minimise(Problem(motion, terms, chosen, trust, _INFLATION[0], huber), initial)
    solved_with = _INFLATION[0]
    for done, inflation in enumerate(_INFLATION):
        if progress is not None:
            progress(done + 1, len(_INFLATION) + 1, "solving")
        before = trust
        trust, chosen = _trust(terms, values, inflation)
        if solved_with == inflation == _INFLATION[-1] and np.abs(trust - before).max(initial=0.0) < _SETTLED:
            break  # the last solve already had these sigmas and, nearly, these probabilities
        believed = np.where(trust < _LEAST_TRUST, 0.0, trust)
        values = minimise(Problem(motion, terms, chosen, believed, inflation, quadratic), values)
        solved_with = inflation
    factors = _weighted(graph, motion, trust, chosen)
    b = len(graph.bearings)
    return Solution(values, factors, trust[:b], trust[b:], chosen, float(factors.error(values)))
