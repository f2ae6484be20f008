"""Several scores together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.stats import rankdata

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.angular_novelty import AngularNovelty
from mulan.planning.scores.ensemble import EnsembleVariance
from mulan.planning.scores.score import Score
from mulan.planning.view import View


@dataclass(frozen=True)
class RankSum(Score):
    """Sum of the candidates' ranks under several scores, whose units then need no exchange rate (Borda).

    Attributes:
        scores: The scores.
    """

    scores: tuple[Score, ...]

    @property
    def fields_needed(self) -> int:
        """As many as the most demanding of them."""
        return max(score.fields_needed for score in self.scores)

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """Ranks from 1 up, ties shared."""
        if not candidates:
            return np.zeros(0)
        return sum(
            (rankdata(score(knowledge, candidates)) for score in self.scores), np.zeros(len(candidates))
        )


def default_score() -> Score:
    """From how new a direction a view sees what it sees, and where the fields disagree.

    The first decides while all views look at the scene, the second once they are narrow or badly pointed.
    """
    return RankSum((AngularNovelty(), EnsembleVariance()))
