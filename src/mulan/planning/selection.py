"""Several views at a time, one after another."""

from collections.abc import Sequence

import numpy as np

from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import Score
from mulan.planning.view import View


def choose_views(score: Score, knowledge: Knowledge, candidates: Sequence[View], count: int) -> list[int]:
    """Indices of the best candidates, each judged knowing that those before it will be taken.

    Greedy: for a score with diminishing returns no choice of as many is worth more than 1/(1 - 1/e) times
    this one (Nemhauser et al. 1978). Of equals the first is taken.
    """
    left = list(range(len(candidates)))
    chosen: list[int] = []
    for _ in range(min(count, len(candidates))):
        worth = score(knowledge, [candidates[i] for i in left])
        best = left.pop(int(np.argmax(worth)))
        chosen.append(best)
        knowledge = knowledge.with_chosen(candidates[best])
    return chosen
