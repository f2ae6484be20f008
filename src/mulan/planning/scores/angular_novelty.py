"""From how new a direction a view sees what it sees."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import RayScore
from mulan.planning.view import View


@dataclass(frozen=True)
class AngularNovelty(RayScore):
    """Of each visible cell, the angle to the nearest direction a chosen view saw it from.

    Farthest-point sampling weighted by visibility: a camera that stood near but looked elsewhere does not
    count. A chosen view of certainty w shortens the angle from the one for cells never seen, but by w only:
    ``w θ + (1 - w) θ_never``.
    """

    never_seen_rad: float = 2.0
    """What a cell counts that no chosen view saw."""

    def information(self, knowledge: Knowledge, candidate: View) -> Float[Tensor, "r"]:
        """Radians, shared by the rays that see the cell."""
        seen = knowledge.look(candidate)
        centre = knowledge.grid.centre_m(seen.cell)
        towards = _unit(_tensor(candidate.position_m) - centre)
        novelty = torch.full((len(centre),), self.never_seen_rad)
        if knowledge.chosen:
            trust = knowledge.chosen_trust[:, seen.cell]
            eyes = torch.stack([_tensor(view.position_m) for view in knowledge.chosen])
            cosine = (towards * _unit(eyes[:, None] - centre)).sum(-1)
            angle_rad = torch.acos(cosine.clamp(-1, 1)).clamp_max(self.never_seen_rad)
            novelty = (trust * angle_rad + (1 - trust) * self.never_seen_rad).amin(0)
        return seen.per_ray(novelty)


def _tensor(point: np.ndarray) -> Float[Tensor, "3"]:
    return torch.tensor(point, dtype=torch.float32)


def _unit(vector: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    return vector / vector.norm(dim=-1, keepdim=True).clamp_min(1e-9)
