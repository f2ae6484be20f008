"""How far one measurement is to be believed while the estimate grows."""

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.factors import bearing_factor, bearing_residual
from mulan.localization.graph import (
    BearingNode,
    RangeNode,
    observed_in_body,
    range_node_factor,
)
from mulan.wireless.types import Bearing

Observed: TypeAlias = tuple[Float[NDArray, "3"], Float[NDArray, "3 d"], Float[NDArray, "d d"]]

_LEAST_TRUST = 0.02  # below it a measurement is left out
_DETOUR_SPAN_M = 10.0  # wrong ranges are spread over so many metres


@dataclass
class OnlineMeasurement:
    """A measurement in the graph, or kept out of it for now.

    Attributes:
        node: Tied to its keyframes.
        trust: Probability that it is right, as its factor has it.
        hypothesis: Which direction of a bearing its factor has.
        slot: Index of its factor in the solver; None while it is left out.
        age: Updates since it came.
    """

    node: BearingNode | RangeNode
    age: int = 0
    trust: float = 0.0
    hypothesis: int = 0
    slot: int | None = None

    @cached_property
    def observed(self) -> list[Observed]:
        """Every hypothesis of a bearing, in the observer keyframe's body axes."""
        assert isinstance(self.node, BearingNode)
        return [observed_in_body(self.node, k) for k in range(len(self.node.bearing.weight))]

    @property
    def kept_out(self) -> bool:
        """Whether it is too improbable for a factor."""
        return self.trust < _LEAST_TRUST

    def factor(self) -> gtsam.CustomFactor:
        """With a covariance divided by the trust, as the batch solution has it."""
        node = self.node
        if isinstance(node, RangeNode):
            sigma = node.measurement.sigma_m / np.sqrt(self.trust)
            return range_node_factor(node, gtsam.noiseModel.Isotropic.Sigma(1, sigma))
        u, basis, covariance = self.observed[self.hypothesis]
        noise = gtsam.noiseModel.Gaussian.Covariance(covariance / self.trust)
        return bearing_factor(node.sight, u, basis, noise)


def bearing_trust(
    bearing: Bearing,
    observed: list[Observed],
    v: Float[NDArray, "3"],
    spread: Float[NDArray, "3 3"],
) -> tuple[float, int]:
    """Probability that any hypothesis is right, and the likeliest.

    Args:
        bearing: Its weights.
        observed: Its hypotheses in the body axes of the observer's keyframe.
        v: Predicted vector from the observer's point to the peer's, observer's body axes.
        spread: Covariance of that prediction [m²]; zeros once the bearing itself is in the estimate.
    """
    density = []
    for weight, (u, basis, covariance) in zip(bearing.weight, observed, strict=True):
        residual, by_v = bearing_residual(v, u, basis)
        covariance = covariance + by_v @ spread @ by_v.T
        squared = float(residual @ np.linalg.solve(covariance, residual))
        density.append(weight * np.exp(-0.5 * squared) / np.sqrt(np.linalg.det(2 * np.pi * covariance)))
    inside = float(np.sum(density))
    level = not np.isfinite(bearing.tangent_covariance[0, 1, 1])
    outside = bearing.outlier_mass / ((2 if level else 4) * np.pi)
    if inside + outside <= 0.0:
        return 0.0, 0
    return inside / (inside + outside), int(np.argmax(density))


def range_trust(
    node: RangeNode, v: Float[NDArray, "3"], bias_m: float, spread: Float[NDArray, "3 3"], outlier_mass: float
) -> float:
    """Probability that the range took no detour; arguments as for a bearing."""
    distance = max(float(np.linalg.norm(v)), 1e-9)
    variance = node.measurement.sigma_m**2 + float(v @ spread @ v) / distance**2
    squared = (distance + bias_m - node.measurement.range_m) ** 2 / variance
    inside = (1 - outlier_mass) * np.exp(-0.5 * squared) / np.sqrt(2 * np.pi * variance)
    outside = outlier_mass / _DETOUR_SPAN_M
    return float(inside / (inside + outside)) if inside + outside > 0 else 0.0
