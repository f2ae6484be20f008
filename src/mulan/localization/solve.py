"""Solving the graph with outliers: Huber first, then every measurement weighted by its probability."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.localization.belief import belief, log_likelihoods
from mulan.localization.graph import (
    LocalizationGraph,
    bearing_node_factor,
    observed_in_body,
    range_node_factor,
)
from mulan.localization.graph_covariances import moved
from mulan.localization.least_squares import Problem, minimise
from mulan.localization.measurement_terms import MeasurementTerms, huber, measurement_terms, quadratic

_INFLATION = (3.0, 1.5, 1.0, 1.0, 1.0, 1.0)  # wide at first: a poor start rejects nothing for good
_TRIED = (1.5, 1.0, 1.0)  # sigmas while one measurement is disbelieved or forced
_SHARP = (1.0, 1.0, 1.0, 1.0)  # sigmas as they are, from a start that is already good
_HOPELESS = 12.0  # nats worse than the best: not another explanation
_SETTLED = 0.02  # probabilities that change less need no further round
_MOST_FLIPPED = 40  # with so many measurements a single one no longer makes a second explanation
_FORCED = 25.0  # information of a measurement that is to be believed, as a try
_LEAST_PROBABLE = 1e-3  # explanations less probable than this are left out
_DOUBTED = 0.5  # a measurement less trusted gives reason to look for another solution
_LEAST_TRUST = 1e-5  # hardly any information, but the graph stays determined where all are doubted


@dataclass(frozen=True)
class Solution:
    """The optimised graph.

    Attributes:
        values: Poses and biases.
        graph: With Gaussian noise scaled by the final probabilities; marginals come from it.
        bearing_inlier, range_inlier: Probability that each measurement was right.
        hypothesis: Which direction of each bearing was used.
        cost: Final graph error.
        other_modes: Poses of other explanations with their probabilities, where few measurements leave
            several; ``values`` is the mean of all.
    """

    values: gtsam.Values
    graph: gtsam.NonlinearFactorGraph
    bearing_inlier: Float[NDArray, "m"]
    range_inlier: Float[NDArray, "r"]
    hypothesis: Int[NDArray, "m"]
    cost: float
    other_modes: tuple[tuple[float, gtsam.Values], ...] = ()


def _weighted(
    graph: LocalizationGraph,
    motion: gtsam.NonlinearFactorGraph,
    trust: Float[NDArray, "m"],
    chosen: Int[NDArray, "b"],
) -> gtsam.NonlinearFactorGraph:
    """The motion and every believed measurement, its covariance divided by its trust."""
    factors = motion.clone()
    trust = np.maximum(trust, _LEAST_TRUST)
    for node, believed, k in zip(graph.bearings, trust, chosen, strict=False):
        noise = gtsam.noiseModel.Gaussian.Covariance(observed_in_body(node, int(k))[2] / believed)
        factors.add(bearing_node_factor(node, int(k), noise))
    for node, believed in zip(graph.ranges, trust[len(graph.bearings) :], strict=True):
        noise = gtsam.noiseModel.Isotropic.Sigma(1, node.measurement.sigma_m / np.sqrt(believed))
        factors.add(range_node_factor(node, noise))
    return factors


@dataclass(frozen=True)
class _State:
    """Poses, the probability that each measurement is right, the hypotheses, and minus the log posterior."""

    values: gtsam.Values
    trust: Float[NDArray, "m"]
    chosen: Int[NDArray, "b"]
    cost: float


def _alike(a: _State, b: _State) -> bool:
    return abs(a.cost - b.cost) < 0.05 and bool(np.abs(a.trust - b.trust).max() < 0.1)


def _triangles(
    linear: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering
) -> Iterator[Float[NDArray, "d d"]]:
    net = linear.eliminateSequential(ordering)
    for i in range(net.size()):
        yield net.at(i).R()


@dataclass(frozen=True)
class _Rounds:
    """Expectation-maximisation on one graph."""

    graph: LocalizationGraph
    terms: MeasurementTerms
    motion: gtsam.NonlinearFactorGraph

    def settle(
        self,
        values: gtsam.Values,
        inflations: Sequence[float],
        progress: Callable[[int, int, str], None] | None = None,
        clamped: tuple[int, float] | None = None,
    ) -> _State:
        """Alternate probabilities and poses, with sigmas inflated by each of these factors in turn.

        One measurement's weight may be clamped, whatever its probability.
        """
        trust = np.full(len(self.terms.observer), np.nan)
        chosen = np.zeros(len(self.terms.direction), dtype=int)
        solved_with = np.nan
        for done, inflation in enumerate(inflations):
            if progress is not None:
                progress(done + 1, len(inflations) + 1, "solving")
            before = trust
            trust, chosen = belief(self.terms, self.terms.poses(values), inflation)
            if solved_with == inflation == inflations[-1] and not (np.abs(trust - before) > _SETTLED).any():
                break  # the last solve already had these sigmas and, nearly, these probabilities
            believed = np.maximum(trust, _LEAST_TRUST)
            if clamped is not None:
                believed[clamped[0]] = clamped[1]
            values = minimise(
                Problem(self.motion, self.terms, chosen, believed, inflation, quadratic), values
            )
            solved_with = inflation
        log_right, log_wrong, _ = log_likelihoods(self.terms, self.terms.poses(values), 1.0)
        cost = self.motion.error(values) - float(np.logaddexp(log_right, log_wrong).sum())
        return _State(values, trust, chosen, cost)

    def modes(self, found: _State) -> list[_State]:
        """Explanations reached by believing one measurement less or one more, the found one among them.

        Where few measurements meet outliers, which of them is wrong may stay open: then the posterior has
        several modes, and the covariance of one alone would be overconfident.
        """
        states = [found]
        for i, believed in enumerate(found.trust):
            weight = 0.0 if believed >= _DOUBTED else _FORCED
            tried = self.settle(found.values, _TRIED, clamped=(i, weight))
            state = self.settle(tried.values, _SHARP)
            if state.cost < found.cost + _HOPELESS and not any(_alike(state, other) for other in states):
                states.append(state)
        return states

    def mean(self, found: _State, states: Sequence[_State]) -> Solution:
        """The posterior mean over modes, each a Gaussian of its own evidence; the best gives the graph."""
        log_evidence = np.array([-state.cost - self._log_determinant(state) / 2 for state in states])
        if len(states) == 1 or not np.isfinite(log_evidence).any():
            return self.solution(found)
        weight = np.exp(log_evidence - np.logaddexp.reduce(log_evidence))
        best = states[int(weight.argmax())]
        kept = [(float(w), s) for w, s in zip(weight, states, strict=True) if w > _LEAST_PROBABLE]
        total = sum(w for w, _ in kept)
        shift = gtsam.VectorValues()
        for key in (*self.terms.pose_keys, *self.terms.bias_keys):
            shift.insert(key, sum(w / total * moved(best.values, s.values, key) for w, s in kept))
        solution = self.solution(best)
        modes = tuple((w / total, s.values) for w, s in kept) if len(kept) > 1 else ()
        return replace(solution, values=best.values.retract(shift), other_modes=modes)

    def _log_determinant(self, state: _State) -> float:
        trust = np.maximum(state.trust, _LEAST_TRUST)
        problem = Problem(self.motion, self.terms, state.chosen, trust, 1.0, quadratic)
        linear = problem.linear(state.values)[0]
        ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        try:
            return 2 * float(np.sum([np.log(np.abs(np.diag(R))).sum() for R in _triangles(linear, ordering)]))
        except RuntimeError:  # indeterminate: nothing is left that holds a robot
            return np.inf

    def solution(self, state: _State) -> Solution:
        """The outcome, with the graph its covariances come from."""
        factors = _weighted(self.graph, self.motion, state.trust, state.chosen)
        b = len(self.graph.bearings)
        return Solution(
            state.values,
            factors,
            state.trust[:b],
            state.trust[b:],
            state.chosen,
            float(factors.error(state.values)),
        )


def solve_graph(
    graph: LocalizationGraph,
    initial: gtsam.Values,
    progress: Callable[[int, int, str], None] | None = None,
) -> Solution:
    """Most probable poses, and which measurements to believe.

    Expectation-maximisation over the bearings' mixtures and the ranges' outliers, sigmas inflated at first;
    each round is one Levenberg-Marquardt solve. Where doubts remain, a second path begins with a robust fit
    of all measurements, and the more probable outcome is kept. A measurement's covariance is divided by its
    probability of being right, so that doubt also widens the marginals.
    """
    terms, motion = measurement_terms(graph), graph.motion_factors()
    rounds = _Rounds(graph, terms, motion)
    found = rounds.settle(initial, _INFLATION, progress)
    if (found.trust < _DOUBTED).any():
        # a fit that believes no one fully may be pulled to a place from which the right ones look wrong
        everything, none_chosen = np.ones(len(terms.observer)), np.zeros(len(terms.direction), dtype=int)
        robust = Problem(motion, terms, none_chosen, everything, _INFLATION[0], huber)
        other = rounds.settle(minimise(robust, initial), _INFLATION, None)
        found = min(found, other, key=lambda state: state.cost)
    if len(terms.observer) > _MOST_FLIPPED:
        return rounds.solution(found)
    return rounds.mean(found, rounds.modes(found))


def refine_solution(graph: LocalizationGraph, solution: Solution) -> Solution:
    """Further rounds from an earlier solution, after the graph's odometry changed a little."""
    rounds = _Rounds(graph, measurement_terms(graph), graph.motion_factors())
    return rounds.solution(rounds.settle(solution.values, (1.0,), None))
