"""By what a robot's bearings seem turned, or its ranges too long, to first order: no second solve."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.localization.factors import bearing_residual, line_of_sight
from mulan.localization.graph import LocalizationGraph, observed_in_body
from mulan.localization.marginals import columns, solve_normal_equations
from mulan.localization.solve import Solution

_LEAST_TRUST = 0.02  # the solver leaves out what it trusts less


@dataclass(frozen=True)
class Misfit:
    """One extra unknown of the team, were it added to the solved graph.

    Attributes:
        amount: Its estimate: a turn [rad] or a bias [m].
        sigma: Of that.
    """

    amount: float
    sigma: float

    @property
    def nats(self) -> float:
        """How much likelier the measurements would be with it."""
        return 0.5 * (self.amount / self.sigma) ** 2


@dataclass(frozen=True)
class _Row:
    """One whitened measurement: its residual and derivatives by two poses and by the lie it might carry."""

    first: int
    second: int
    residual: Float[NDArray, "d"]
    by_first: Float[NDArray, "d 6"]
    by_second: Float[NDArray, "d 6"]
    by_lie: Float[NDArray, "d"]


def _bearing_rows(graph: LocalizationGraph, solution: Solution) -> list[_Row | None]:
    rows: list[_Row | None] = []
    for node, trust, k in zip(graph.bearings, solution.bearing_inlier, solution.hypothesis, strict=True):
        if trust < _LEAST_TRUST:
            rows.append(None)
            continue
        poses = (node.sight.observer_key, node.sight.peer_key)
        T_first, T_second = (solution.values.atPose3(key).matrix() for key in poses)
        v, by_first, by_second = line_of_sight(T_first, T_second, node.sight)
        u, basis, covariance = observed_in_body(node, int(k))
        residual, by_v = bearing_residual(v, u, basis)
        whitener = np.linalg.inv(np.linalg.cholesky(covariance / trust))
        turned = np.cross(node.R_body_odom[:, 2], v)  # the vertical of the odometry in body axes
        J = whitener @ by_v
        rows.append(_Row(*poses, whitener @ residual, J @ by_first, J @ by_second, J @ turned))
    return rows


def _range_rows(graph: LocalizationGraph, solution: Solution) -> list[_Row | None]:
    rows: list[_Row | None] = []
    for node, trust in zip(graph.ranges, solution.range_inlier, strict=True):
        if trust < _LEAST_TRUST:
            rows.append(None)
            continue
        poses = (node.sight.observer_key, node.sight.peer_key)
        T_first, T_second = (solution.values.atPose3(key).matrix() for key in poses)
        v, by_first, by_second = line_of_sight(T_first, T_second, node.sight)
        distance = max(float(np.linalg.norm(v)), 1e-9)
        u = v[None] / distance
        weight = np.sqrt(trust) / node.measurement.sigma_m
        residual = distance + solution.values.atVector(node.bias_key)[0] - node.measurement.range_m
        rows.append(
            _Row(
                *poses,
                np.array([residual * weight]),
                u @ by_first * weight,
                u @ by_second * weight,
                np.array([weight]),
            )
        )
    return rows


def misfits(
    graph: LocalizationGraph,
    solution: Solution,
    bearings: Sequence[Bool[NDArray, "m"]],
    ranges: Sequence[Bool[NDArray, "r"]],
) -> list[Misfit | None]:
    """One for every pair of masks: a common turn of those bearings, a common bias of those ranges.

    The Gauss-Newton step of one more unknown, all poses free (Rao's score test); None where the masked
    measurements are all left out or leave it open.

    Args:
        graph: Solved.
        solution: Of it.
        bearings: Masks over the graph's bearings, one a question.
        ranges: Masks over its ranges, likewise.
    """
    rows = _bearing_rows(graph, solution), _range_rows(graph, solution)
    column = columns(solution.values)
    bias = {(n.sight.observer_key, n.sight.peer_key): n.bias_key for n in graph.ranges}
    count = len(bearings)
    cross = np.zeros((solution.values.dim(), count))
    own, slope = np.zeros(count), np.zeros(count)
    for q, masks in enumerate(zip(bearings, ranges, strict=True)):
        for kind, mask in enumerate(masks):
            for i in np.flatnonzero(mask):
                row = rows[kind][i]
                if row is None:
                    continue
                for key, J in ((row.first, row.by_first), (row.second, row.by_second)):
                    cross[column[key] : column[key] + 6, q] += J.T @ row.by_lie
                if kind == 1:
                    cross[column[bias[row.first, row.second]], q] += float(row.by_lie @ row.by_lie)
                own[q] += float(row.by_lie @ row.by_lie)
                slope[q] += float(row.by_lie @ row.residual)
    information = own - np.einsum(
        "nq,nq->q", cross, solve_normal_equations(solution.graph, solution.values, cross)
    )
    return [
        Misfit(-s / i, 1 / np.sqrt(i)) if i > 1e-6 * max(o, 1e-12) and o > 0 else None
        for s, i, o in zip(slope.tolist(), information.tolist(), own.tolist(), strict=True)
    ]
