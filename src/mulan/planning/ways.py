"""Several moves at a time: what a way would teach, not only its first view."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.cell_worth import CellWorth
from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.score import RayScore
from mulan.planning.view import View

Way = Sequence[View]
"""Views a robot would take one after another."""


def worth_of_ways(
    knowledge: Knowledge, ways: Sequence[Way], scores: Sequence[RayScore]
) -> Float[NDArray, "n"]:
    """Worth of each way, every cell counted once, by the view of the way that teaches most about it.

    A robot that looks only one short move ahead sees little difference between its moves and wavers. The
    unit is the worth of a mean view.

    Args:
        knowledge: Fields and views so far.
        ways: Ways, of any lengths.
        scores: What a ray of a view would teach; they count alike.
    """
    worth = CellWorth(scores, knowledge).of([view for way in ways for view in way])
    ends = np.cumsum([0, *(len(way) for way in ways)])
    return np.array(
        [float(worth[begin:end].max(axis=0).sum()) if end > begin else 0.0 for begin, end in pairwise(ends)]
    )
