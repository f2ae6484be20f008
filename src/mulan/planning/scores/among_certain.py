"""Only views whose place is well known, whatever else would be learnt."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import Score
from mulan.planning.view import View


@dataclass(frozen=True)
class AmongCertain(Score):
    """Another score among the candidates below a limit; above it the more certain come first.

    Attributes:
        score: Decides among the certain.
        most_sigma_m: Candidates whose position has a larger standard deviation count as uncertain.
    """

    score: Score
    most_sigma_m: float

    @property
    def fields_needed(self) -> int:
        """What the score within needs."""
        return self.score.fields_needed

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """The score within, all uncertain candidates below all certain ones."""
        worth = self.score(knowledge, candidates)
        sigma_m = np.array([view.sigma_m for view in candidates])
        return np.where(sigma_m <= self.most_sigma_m, worth, worth.min(initial=0.0) - 1 - sigma_m)
