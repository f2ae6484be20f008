"""Covariances out of the solved graph, of any few keyframes together."""

from collections.abc import Sequence

import gtsam
import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.graph import LocalizationGraph
from mulan.localization.graph_covariances import GraphCovariances
from mulan.localization.solve import Solution


class TeamMarginals:
    """Joint covariances of keyframes, widened by what else was estimated beside the graph.

    Args:
        graph: Gives the keys.
        solution: Solved.
        side_response: How all variables of the graph, in the order of their keys, move with some estimated
            beside it (one column each, per unit); none by default.
        side_covariance: Of those.
    """

    def __init__(
        self,
        graph: LocalizationGraph,
        solution: Solution,
        side_response: Float[NDArray, "n s"] | None = None,
        side_covariance: Float[NDArray, "s s"] | None = None,
    ) -> None:
        self._graph, self._solution = graph, solution
        self._marginals = GraphCovariances(solution.graph, solution.values, solution.other_modes)
        self._column = columns(solution.values)
        self._response, self._side = side_response, side_covariance

    def joint(self, keyframes: Sequence[tuple[str, int]]) -> Float[NDArray, "d d"]:
        """Covariance of keyframes (robot, index), six rows each, in the order given; each only once."""
        keys = [self._graph.key(robot, index) for robot, index in keyframes]
        covariance = self._marginals.joint(keys)
        if self._response is None or self._side is None:
            return covariance
        rows = np.concatenate([np.arange(self._column[key], self._column[key] + 6) for key in keys])
        response = self._response[rows]
        return covariance + response @ self._side @ response.T

    def joint_of_many(self, keyframes: Sequence[tuple[str, int]]) -> Float[NDArray, "d d"]:
        """The same for any number of keyframes in one solve; each may come more than once."""
        keys = [self._graph.key(robot, index) for robot, index in keyframes]
        rows = np.concatenate([np.arange(self._column[key], self._column[key] + 6) for key in keys])
        values = self._solution.values
        units = np.zeros((values.dim(), len(rows)))
        units[rows, np.arange(len(rows))] = 1
        covariance = solve_normal_equations(self._solution.graph, values, units)[rows]
        covariance = (covariance + covariance.T) / 2 + self._marginals.spread(keys)
        if self._response is None or self._side is None:
            return covariance
        return covariance + self._response[rows] @ self._side @ self._response[rows].T


def columns(values: gtsam.Values) -> dict[int, int]:
    """First column of every variable when they are ordered by key."""
    column, next_free = {}, 0
    for key in sorted(values.keys()):
        column[key] = next_free
        next_free += 6 if _is_pose(values, key) else len(values.atVector(key))
    return column


def _is_pose(values: gtsam.Values, key: int) -> bool:
    try:
        values.atPose3(key)
    except RuntimeError:
        return False
    return True


def solve_normal_equations(
    factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, right: Float[NDArray, "n s"]
) -> Float[NDArray, "n s"]:
    """``H⁻¹ right`` with the Gauss-Newton Hessian H of the graph, variables ordered by key."""
    entries = factors.linearize(values).sparseJacobian_()
    row, column = entries[0].astype(int) - 1, entries[1].astype(int) - 1
    inside = column < len(right)  # the last column is the right-hand side
    J = scipy.sparse.csc_matrix(
        (entries[2][inside], (row[inside], column[inside])), shape=(row.max() + 1, len(right))
    )
    H = J.T @ J
    scale = 1 / np.sqrt(H.diagonal())  # the anchor's prior is 10^12 times the weakest entry
    scaled = scipy.sparse.diags(scale) @ H @ scipy.sparse.diags(scale)
    factor = scipy.sparse.linalg.splu(
        scaled.tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return scale[:, None] * factor.solve(scale[:, None] * right)
