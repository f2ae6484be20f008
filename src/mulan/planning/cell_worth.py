"""What each candidate would add to each cell of the scene, so that views of a team can be added up."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy.sparse import csr_array

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

    def of(self, candidates: Sequence[View]) -> csr_array:
        """Worth of each candidate (row) in each cell (column); the first call sets the units."""
        for score in self._scores:
            score.look_ahead(self._knowledge, candidates)
        found = [_by_cell(self._scores, self._knowledge, view) for view in candidates]
        parts = [
            _rows([(cell, worth[k]) for cell, worth in found], self._knowledge.grid.cells)
            for k in range(len(self._scores))
        ]
        if self._units is None and candidates:
            self._units = tuple(max(float(part.sum()) / len(candidates), 1e-12) for part in parts)
        total = csr_array((len(candidates), self._knowledge.grid.cells), dtype=np.float32)
        for part, unit in zip(parts, self._units or (), strict=bool(self._units)):
            total = total + part / unit
        return total / len(parts)


def _by_cell(
    scores: Sequence[RayScore], knowledge: Knowledge, candidate: View
) -> tuple[Int[NDArray, "seen"], list[Float[NDArray, "seen"]]]:
    """Cells a candidate sees, and by each score what it would teach in each."""
    look = knowledge.look(candidate)
    sights = torch.bincount(look.ray, minlength=len(look.origins)).clamp_min(1)
    cell, number = look.seen.cell, look.seen.of_sight
    worth = []
    for score in scores:
        of_ray = score.information(knowledge, candidate) * look.certainty / sights
        worth.append(torch.zeros(len(cell)).index_add(0, number, of_ray[look.ray]).numpy())
    return cell.numpy(), worth


def _rows(found: Sequence[tuple[Int[NDArray, "_"], Float[NDArray, "_"]]], cells: int) -> csr_array:
    """One row a candidate."""
    ends = np.cumsum([0, *(len(cell) for cell, _ in found)])
    cell = np.concatenate([np.zeros(0, np.int64), *(cell for cell, _ in found)])
    value = np.concatenate([np.zeros(0, np.float32), *(value for _, value in found)])
    return csr_array((value, cell, ends), shape=(len(found), cells))
