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


class CellWorth:
    """Worth of views by cell, in units of the mean of the candidates first judged.

    Each score's information, times the trust the pose allows, is shared by the cells a ray sees; the scores
    then count alike, whatever their units.
    """

    def __init__(self, scores: Sequence[RayScore], knowledge: Knowledge) -> None:
        self._scores, self._knowledge = tuple(scores), knowledge
        self._units: tuple[float, ...] | None = None

    def of(self, candidates: Sequence[View]) -> Float[NDArray, "n cells"]:
        """Worth of each candidate in each cell; the first call sets the units."""
        shape = len(candidates), self._knowledge.grid.cells
        parts = [
            np.array([_by_cell(score, self._knowledge, view).numpy() for view in candidates]).reshape(shape)
            for score in self._scores
        ]
        if self._units is None and candidates:
            self._units = tuple(max(float(part.sum(1).mean()), 1e-12) for part in parts)
        total = np.zeros(shape, np.float32)
        for part, unit in zip(parts, self._units or (), strict=bool(self._units)):
            total += part / unit
        return total / len(parts)


def _by_cell(score: RayScore, knowledge: Knowledge, candidate: View) -> Float[Tensor, "cells"]:
    seen = knowledge.look(candidate)
    of_ray = score.information(knowledge, candidate) * seen.certainty
    of_ray = of_ray / torch.bincount(seen.ray, minlength=len(of_ray)).clamp_min(1)
    return torch.zeros(knowledge.grid.cells).index_add(0, seen.cell, of_ray[seen.ray])
