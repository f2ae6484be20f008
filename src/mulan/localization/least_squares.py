"""Levenberg-Marquardt over a graph whose bearings and ranges are linearised together."""

from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.localization.measurement_terms import MeasurementTerms, RowWeight

_MOST_ITERATIONS = 50
_RELATIVE_GAIN, _ABSOLUTE_GAIN = 1e-5, 1e-3  # smaller gains in cost end the search
_FIRST_DAMPING, _MOST_DAMPING = 1e-5, 1e5


@dataclass(frozen=True)
class Rows:
    """Which measurements stand in one factor: those between the same two poses.

    Attributes:
        order: Measurement indices, those of one factor together.
        bounds: Where each factor begins and ends in it.
        swapped: Whether a measurement's observer has the larger key.
    """

    order: Int[NDArray, "m"]
    bounds: Int[NDArray, "f"]
    swapped: NDArray


def _grouped(terms: MeasurementTerms) -> Rows:
    """Bearings between two poses make one factor, ranges between them another (it also holds their bias)."""
    low, high = np.minimum(terms.observer, terms.peer), np.maximum(terms.observer, terms.peer)
    is_range = np.arange(len(low)) >= len(terms.direction)
    group = np.stack([is_range, low, high], 1)
    order = np.lexsort((high, low, is_range))
    new = np.ones(len(order), dtype=bool)
    new[1:] = (np.diff(group[order], axis=0) != 0).any(1)
    return Rows(order, np.append(np.flatnonzero(new), len(order)), terms.observer > terms.peer)


@dataclass(frozen=True)
class Problem:
    """What is minimised.

    Attributes:
        motion: Every factor that gtsam knows.
        terms: Bearings and ranges.
        chosen: Hypothesis of each bearing.
        trust: Divides each measurement's covariance; zero leaves it out.
        inflation: Multiplies every measurement's sigma.
        kernel: Robust or plain.
    """

    motion: gtsam.NonlinearFactorGraph
    terms: MeasurementTerms
    chosen: Int[NDArray, "b"]
    trust: Float[NDArray, "m"]
    inflation: float
    kernel: RowWeight

    def _scale2(self) -> Float[NDArray, "m"]:
        return self.trust / self.inflation**2

    def cost(self, values: gtsam.Values) -> float:
        """Half the sum of squares (robust where the kernel is)."""
        terms, poses = self.terms, self.terms.poses(values)
        residual = terms.linearise(poses, self.chosen)[0]
        return self.motion.error(values) + float(self.kernel(self._scale2() * (residual**2).sum(1))[0].sum())

    def linear(self, values: gtsam.Values) -> tuple[gtsam.GaussianFactorGraph, float]:
        """Normal equations about the values, and the cost there."""
        terms, poses, rows = self.terms, self.terms.poses(values), _grouped(self.terms)
        graph = self.motion.linearize(values)
        residual, J_observer, J_peer = terms.linearise(poses, self.chosen)
        scale2 = self._scale2()
        cost, weight = self.kernel(scale2 * (residual**2).sum(1))
        root = np.sqrt(scale2 * weight)
        swapped, order = rows.swapped[:, None, None], rows.order
        J_low = (root[:, None, None] * np.where(swapped, J_peer, J_observer))[order]
        J_high = (root[:, None, None] * np.where(swapped, J_observer, J_peer))[order]
        right = (-root[:, None] * residual)[order]
        low = np.minimum(terms.observer, terms.peer)[order]
        high = np.maximum(terms.observer, terms.peer)[order]
        bearings, ranges_of = len(terms.direction), terms.sigma_m
        for begin, end in zip(rows.bounds[:-1], rows.bounds[1:], strict=True):
            keys = terms.pose_keys[low[begin]], terms.pose_keys[high[begin]]
            first = order[begin]
            if first < bearings or not terms.bias_keys:
                A, B, c = J_low[begin:end].reshape(-1, 6), J_high[begin:end].reshape(-1, 6), right[begin:end]
                graph.add(gtsam.JacobianFactor(keys[0], A, keys[1], B, c.ravel(), _unit(len(A))))
            else:
                of = order[begin:end]
                by_bias = (root[of] / ranges_of[of - bearings])[:, None]
                bias_key = terms.bias_keys[terms.bias[first - bearings]]
                graph.add(
                    gtsam.JacobianFactor(
                        keys[0], J_low[begin:end, 0], keys[1], J_high[begin:end, 0],
                        bias_key, by_bias, right[begin:end, 0], _unit(len(of)),
                    )
                )  # fmt: skip
        return graph, self.motion.error(values) + float(cost.sum())


def _unit(rows: int) -> gtsam.noiseModel.Unit:
    return gtsam.noiseModel.Unit.Create(rows)


def _damped(
    linear: gtsam.GaussianFactorGraph, keys: list[tuple[int, int]], damping: float
) -> gtsam.GaussianFactorGraph:
    graph = gtsam.GaussianFactorGraph()
    graph.push_back(linear)
    for key, size in keys:
        graph.add(gtsam.JacobianFactor(key, np.sqrt(damping) * np.eye(size), np.zeros(size), _unit(size)))
    return graph


def minimise(problem: Problem, values: gtsam.Values) -> gtsam.Values:
    """The values of least cost near the given ones: Gauss-Newton, damped where a step does not gain."""
    terms = problem.terms
    sizes = [(key, 6) for key in terms.pose_keys] + [(key, 1) for key in terms.bias_keys]
    damping, ordering = 0.0, None  # every step has the same structure, so one elimination order serves all
    for _ in range(_MOST_ITERATIONS):
        linear, cost = problem.linear(values)
        if ordering is None:
            ordering = gtsam.Ordering.ColamdGaussianFactorGraph(linear)
        while True:
            system = linear if damping == 0.0 else _damped(linear, sizes, damping)
            try:
                moved = values.retract(system.optimize(ordering))
                new_cost = problem.cost(moved)
            except RuntimeError:  # an indeterminate system: damping makes it solvable
                new_cost = np.inf
                moved = values
            if new_cost <= cost:
                damping = 0.0 if damping <= _FIRST_DAMPING else damping / 10
                break
            damping = max(damping * 10, _FIRST_DAMPING)
            if damping > _MOST_DAMPING:
                return values
        values = moved
        if cost - new_cost < max(_ABSOLUTE_GAIN, _RELATIVE_GAIN * cost):
            break
    return values
