"""Measurements of the online window, and their arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.factors import Sight
from mulan.localization.graph import BearingNode, RangeNode, observed_in_body
from mulan.localization.measurement_terms import MeasurementTerms


@dataclass(eq=False)
class OnlineMeasurement:
    """A measurement in the window.

    Attributes:
        node: Tied to its keyframes.
        spread: Joint covariance of its two poses before it is in the estimate; None from then on.
        trust: Probability that it is right.
        hypothesis: Which direction of a bearing is used.
    """

    node: BearingNode | RangeNode
    spread: Float[NDArray, "12 12"] | None = None
    trust: float = 0.0
    hypothesis: int = 0

    @property
    def sight(self) -> Sight:
        """Poses and points it joins."""
        return self.node.sight

    @cached_property
    def hypotheses(self) -> tuple[NDArray, NDArray, NDArray, NDArray, int]:
        """Direction, basis, covariance, log weight of each of a bearing's, and how many axes it observed."""
        assert isinstance(self.node, BearingNode)
        h = len(self.node.bearing.weight)
        direction, basis, covariance = np.zeros((h, 3)), np.zeros((h, 3, 2)), np.tile(np.eye(2), (h, 1, 1))
        axes = 2
        for k in range(h):
            u, columns, spread = observed_in_body(self.node, k)
            axes = columns.shape[1]
            direction[k], basis[k, :, :axes], covariance[k, :axes, :axes] = u, columns, spread
        return direction, basis, covariance, np.log(np.maximum(self.node.bearing.weight, 1e-300)), axes


def window_terms(
    bearings: Sequence[OnlineMeasurement], ranges: Sequence[OnlineMeasurement], range_outlier_mass: float
) -> MeasurementTerms:
    """Arrays of the measurements of a window, bearings first."""
    sights = [m.sight for m in (*bearings, *ranges)]
    keys = tuple(sorted({key for s in sights for key in (s.observer_key, s.peer_key)}))
    at = {key: i for i, key in enumerate(keys)}
    told = [m.hypotheses for m in bearings]
    b, h = len(bearings), max((len(t[0]) for t in told), default=1)
    direction, basis = np.tile([1.0, 0.0, 0.0], (b, h, 1)), np.zeros((b, h, 3, 2))
    covariance, log_weight = np.tile(np.eye(2), (b, h, 1, 1)), np.full((b, h), -np.inf)
    for i, (u, columns, spread, log_w, _) in enumerate(told):
        n = len(u)
        direction[i, :n], basis[i, :n], covariance[i, :n], log_weight[i, :n] = u, columns, spread, log_w
    nodes = [m.node for m in ranges if isinstance(m.node, RangeNode)]
    bias_keys = tuple(sorted({node.bias_key for node in nodes}))
    bias_at = {key: i for i, key in enumerate(bias_keys)}
    mass = [m.node.bearing.outlier_mass for m in bearings if isinstance(m.node, BearingNode)]
    for node in nodes:
        given = node.measurement.outlier_mass
        mass.append(range_outlier_mass if given is None else given)
    return MeasurementTerms(
        pose_keys=keys,
        bias_keys=bias_keys,
        observer=np.array([at[s.observer_key] for s in sights], dtype=int),
        peer=np.array([at[s.peer_key] for s in sights], dtype=int),
        observer_body_m=np.array([s.observer_body_m for s in sights], dtype=float).reshape(-1, 3),
        peer_body_m=np.array([s.peer_body_m for s in sights], dtype=float).reshape(-1, 3),
        direction=direction,
        basis=basis,
        covariance=covariance,
        log_weight=log_weight,
        axes=np.array([t[4] for t in told], dtype=int),
        outlier_mass=np.array(mass, dtype=float),
        range_m=np.array([node.measurement.range_m for node in nodes], dtype=float),
        sigma_m=np.array([node.measurement.sigma_m for node in nodes], dtype=float),
        bias=np.array([bias_at[node.bias_key] for node in nodes], dtype=int),
    )
