"""Several scores together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.angular_novelty import AngularNovelty
from mulan.planning.scores.ensemble import EnsembleVariance
from mulan.planning.scores.score import Score
from mulan.planning.view import View


@dataclass(frozen=True)
class MeanSum(Score):
    """Sum of several scores of no negative worth, each in units of its mean over the candidates.

    So a score counts as far as it tells the candidates apart: were ranks added, one by which all are nearly
    alike would weigh as much as one that sees some to be worthless.

    Attributes:
        scores: The scores.
    """

    scores: tuple[Score, ...]

    @property
    def fields_needed(self) -> int:
        """As many as the most demanding of them."""
        return max(score.fields_needed for score in self.scores)

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """Around one for each score; one that is nothing for all candidates adds nothing."""
        total = np.zeros(len(candidates))
        for score in self.scores:
            worth = score(knowledge, candidates)
            if worth.any():
                total += worth / worth.mean()
        return total


def default_score() -> Score:
    """From how new a direction a view sees what it sees, and where the fields disagree.

    The first decides while all views look at the scene, the second once they are narrow or badly pointed.
    """
    return MeanSum((AngularNovelty(), EnsembleVariance()))
