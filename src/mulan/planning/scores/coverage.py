"""How much a view sees that few views have seen."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import RayScore
from mulan.planning.view import View


@dataclass(frozen=True)
class Coverage(RayScore):
    """``1/(1 + count)²`` of each visible cell, the chosen views that saw it counting by their certainty."""

    def information(self, knowledge: Knowledge, candidate: View) -> Float[Tensor, "r"]:
        """Shared by the rays that see the cell."""
        seen = knowledge.look(candidate)
        return seen.per_ray(1 / (1 + knowledge.chosen_trust[:, seen.cell].sum(0)) ** 2)
