"""The place farthest from all places views were taken from: no field is asked, and it is hard to beat."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import Score
from mulan.planning.view import View


@dataclass(frozen=True)
class FarthestPoint(Score):
    """Distance to the nearest chosen camera (farthest-point sampling, Eldar et al. 1997)."""

    @property
    def fields_needed(self) -> int:
        """None."""
        return 0

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """Distances [m]; 0 for all before any view was chosen."""
        if not knowledge.chosen:
            return np.zeros(len(candidates))
        chosen = np.stack([view.position_m for view in knowledge.chosen])
        return np.array([np.linalg.norm(chosen - view.position_m, axis=1).min() for view in candidates])
