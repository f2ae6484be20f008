"""How much nearer a view brings everything that could be looked at to something that was."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import Score
from mulan.planning.view import View


@dataclass(frozen=True)
class DirectionCoverage(Score):
    """Fall of the angle between what any candidate would see and the nearest direction it was seen from.

    The candidates stand for the views the field will be asked for: of each cell that each of them would see,
    the angle to the nearest chosen view of that cell is what the field must bridge there. A candidate is
    worth what it takes off the sum of those angles (greedy k-median, where farthest-point sampling is greedy
    k-centre, Gonzalez 1985, and runs to the rim). Views of certainty w bridge ``w θ + (1 - w) θ_never``.
    """

    never_seen_rad: float = 2.0
    """What must be bridged to a cell that no chosen view saw."""

    def __call__(self, knowledge: Knowledge, candidates: Sequence[View]) -> Float[NDArray, "n"]:
        """Radians taken off, summed over cells and candidates that see them."""
        if not candidates:
            return np.zeros(0)
        cells, asked_for = knowledge.grid.cells, self._asked_for(knowledge, candidates)
        seen = torch.stack([look.trust_in_cells(cells) > 0 for look in knowledge.look_at_all(asked_for)])
        met = seen.any(0).nonzero()[:, 0]
        centre = knowledge.grid.centre_m(met)
        towards = torch.stack([_towards(view, centre) for view in asked_for])
        to_bridge = torch.where(seen[:, met], self.never_seen_rad, 0.0)
        for view, trust in zip(knowledge.chosen, knowledge.chosen_trust, strict=True):
            bridged = self._bridged(towards, _towards(view, centre), trust[met])
            to_bridge = torch.minimum(to_bridge, bridged)
        return np.array(
            [
                float((to_bridge - self._bridged(towards, _towards(view, centre), trust)).clamp_min(0).sum())
                for view, trust in (
                    (view, look.trust_in_cells(cells)[met])
                    for view, look in zip(candidates, knowledge.look_at_all(candidates), strict=True)
                )
            ]
        )

    def _asked_for(self, knowledge: Knowledge, candidates: Sequence[View]) -> Sequence[View]:  # noqa: ARG002
        """Views the field will be asked for."""
        return candidates

    def _bridged(
        self, towards: Float[Tensor, "n met 3"], one: Float[Tensor, "met 3"], trust: Float[Tensor, "met"]
    ) -> Float[Tensor, "n met"]:
        """What is left to bridge to each candidate's cells from one view of them."""
        angle_rad = torch.acos((towards * one).sum(-1).clamp(-1, 1)).clamp_max(self.never_seen_rad)
        return trust * angle_rad + (1 - trust) * self.never_seen_rad


def _towards(view: View, centre_m: Float[Tensor, "met 3"]) -> Float[Tensor, "met 3"]:
    """Unit directions from cells to a camera."""
    offset = torch.tensor(view.position_m, dtype=torch.float32) - centre_m
    return offset / offset.norm(dim=-1, keepdim=True).clamp_min(1e-9)
