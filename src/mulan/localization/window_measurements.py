"""Measurements of the online window, and their arrays."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.factors import Sight
from mulan.localization.graph import BearingNode, RangeNode
from mulan.localization.measurement_terms import Hypotheses, MeasurementTerms, gathered_terms


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
    def hypotheses(self) -> Hypotheses:
        """What a bearing may mean."""
        assert isinstance(self.node, BearingNode)
        return Hypotheses.of(self.node)


def window_terms(
    bearings: Sequence[OnlineMeasurement], ranges: Sequence[OnlineMeasurement], range_outlier_mass: float
) -> MeasurementTerms:
    """Arrays of the measurements of a window, bearings first."""
    sights = [m.sight for m in (*bearings, *ranges)]
    keys = tuple(sorted({key for s in sights for key in (s.observer_key, s.peer_key)}))
    seen = [m.node for m in bearings if isinstance(m.node, BearingNode)]
    ranged = [m.node for m in ranges if isinstance(m.node, RangeNode)]
    bias_keys = tuple(sorted({node.bias_key for node in ranged}))
    told = [m.hypotheses for m in bearings]
    return gathered_terms(keys, bias_keys, seen, told, ranged, range_outlier_mass)
