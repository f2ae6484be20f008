"""The interface of all scores."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.planning.knowledge import Knowledge
from mulan.planning.view import View


class Score(ABC):
    """Says how much each candidate is worth; only the order matters."""

    @property
    def fields_needed(self) -> int:
        """How many fields it must be given; 0 where places alone decide."""
        return 1

    @abstractmethod
    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """Worth of each candidate, more is better."""


class RayScore(Score):
    """Worth that is a sum over rays of what each would teach, times the trust its pose allows."""

    @abstractmethod
    def information(self, knowledge: Knowledge, candidate: View) -> Float[Tensor, "r"]:
        """What each ray of a candidate would teach at an exact pose."""

    def look_ahead(self, knowledge: Knowledge, candidates: Sequence[View]) -> None:
        """Let the knowledge look at all candidates at once, before they are asked about one by one."""
        knowledge.look_at_all(candidates)

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """``Σ w_r · information_r``."""
        self.look_ahead(knowledge, candidates)
        return np.array(
            [
                float((self.information(knowledge, view) * knowledge.look(view).certainty).sum())
                for view in candidates
            ]
        )
