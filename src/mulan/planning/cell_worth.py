"""What each candidate would add to each cell of the scene, so that views of a team can be added up."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.angular_novelty import AngularNovelty
from mulan.planning.scores.ensemble import EnsembleVariance
from mulan.planning.scores.score import RayScore
from mulan.planning.view import View


def default_ray_scores(fields: int) -> tuple[RayScore, ...]:
    """From how new a direction, and where the fields disagree if there are several."""
    if fields < 2:
        return (AngularNovelty(),)
    return (AngularNovelty(), EnsembleVariance(fields))


def cell_worth(
    scores: Sequence[RayScore], knowledge: Knowledge, candidates: Sequence[View]
) -> Float[NDArray, "n cells"]:
    """Worth of each candidate by cell; over all cells, the mean candidate is worth 1.

    Each score's information, times the trust the pose allows, is shared by the cells a ray sees; the scores
    then count alike, whatever their units.
    """
    total = np.zeros((len(candidates), knowledge.grid.cells), dtype=np.float32)
    for score in scores:
        worth = torch.stack([_by_cell(score, knowledge, view) for view in candidates]).numpy()
        total += worth / max(float(worth.sum(1).mean()), 1e-12)
    return total / len(scores)


def _by_cell(score: RayScore, knowledge: Knowledge, candidate: View) -> Float[Tensor, "cells"]:
    seen = knowledge.look(candidate)
    of_ray = score.information(knowledge, candidate) * seen.certainty
    of_ray = of_ray / torch.bincount(seen.ray, minlength=len(of_ray)).clamp_min(1)
    return torch.zeros(knowledge.grid.cells).index_add(0, seen.cell, of_ray[seen.ray])
