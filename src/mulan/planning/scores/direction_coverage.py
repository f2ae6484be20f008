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
        cells = knowledge.grid.cells
        trust = torch.stack([knowledge.look(view).trust_in_cells(cells) for view in candidates])
        met = (trust > 0).any(0).nonzero()[:, 0]
        trust, centre = trust[:, met], knowledge.grid.centre_m(met)
        towards = torch.stack([_towards(view, centre) for view in candidates])
        to_bridge = torch.where(trust > 0, self.never_seen_rad, 0.0)
        for view, look in zip(knowledge.chosen, knowledge.chosen_looks, strict=True):
            bridged = self._bridged(towards, _towards(view, centre), look.trust_in_cells(cells)[met])
            to_bridge = torch.minimum(to_bridge, bridged)
        return np.array(
            [
                float((to_bridge - self._bridged(towards, own, of_own)).clamp_min(0).sum())
                for own, of_own in zip(towards, trust, strict=True)
            ]
        )

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
