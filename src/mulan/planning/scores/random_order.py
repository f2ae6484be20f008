"""Views by lot."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import Score
from mulan.planning.view import View


@dataclass(frozen=True)
class RandomOrder(Score):
    """Every candidate is as good as any other: the least a rule must beat."""

    seed: int = 0
    """Of the lots; they also depend on how many views were chosen before."""

    @property
    def fields_needed(self) -> int:
        """None."""
        return 0

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """Lots."""
        return np.random.default_rng([self.seed, len(knowledge.chosen)]).random(len(candidates))
