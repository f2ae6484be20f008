"""Where fields that learnt from the same views disagree."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import RayScore
from mulan.planning.view import View


@dataclass(frozen=True)
class EnsembleVariance(RayScore):
    """Variance of the colour between the members (Lakshminarayanan et al. 2017).

    Rays that miss the scene's box see the same background in all members and count nothing; no term for
    density is added, which before a white background would favour the view with least of the object.
    """

    members: int = 3
    """Fields that vote."""

    @property
    def fields_needed(self) -> int:
        """All members."""
        return self.members

    def look_ahead(self, knowledge: Knowledge, candidates: Sequence[View]) -> None:
        """All members at once."""
        knowledge.disagreements(candidates, self.members)

    def information(self, knowledge: Knowledge, candidate: View) -> Float[Tensor, "r"]:
        """Sample variance of the colour, mean over the channels."""
        return knowledge.disagreement(candidate, self.members)
