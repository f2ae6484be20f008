"""What is known when the next view must be chosen."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.planning.cells import CellGrid
from mulan.planning.look import Look, looks
from mulan.planning.rays import rows_for
from mulan.planning.view import View
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.space import SceneSpace

_RAYS_AT_ONCE = 8192


@dataclass(frozen=True)
class LookConfig:
    """How views are looked at before they are taken."""

    columns: int = 25
    """Rays across a candidate's image."""
    chosen_columns: int = 50
    """Rays across the image of a view that was taken, so that no cell it saw is missed by chance."""
    certainty_columns: int | None = None
    """Rays across the image that say how far the pose lets colours be trusted; half the columns if not given.
    Each is rendered at up to twelve displaced poses, so they cost most."""
    colour_variance: float = 0.005
    """s₀²: colour variance of a pixel whose pose is exact, as in the weights of a training."""


class Knowledge:
    """Fields learnt so far and the views they were learnt from.

    Looks are kept, since several scores ask for the same ones, and again once another view is decided on.

    Attributes:
        fields: Fields learnt from the chosen views, each from its own start; the first stands for all where
            one is enough.
        chosen: Views taken, and those already decided on.
        config: How views are looked at.
        grid: Cells sights are counted in.
    """

    def __init__(
        self,
        fields: Sequence[RadianceEngine],
        space: SceneSpace,
        chosen: Sequence[View],
        config: LookConfig | None = None,
    ) -> None:
        self.fields, self.chosen = tuple(fields), tuple(chosen)
        self.config, self.grid = config or LookConfig(), CellGrid.of(space)
        self._looks: dict[tuple[View, int], Look] = {}
        self._trust: dict[View, Float[Tensor, "cells"]] = {}
        self._disagreement: dict[tuple[View, int], Float[Tensor, "r"]] = {}

    def with_chosen(self, view: View) -> "Knowledge":
        """The same fields once a view is decided on, before anything was learnt from it."""
        more = Knowledge(self.fields, self.grid.space, (*self.chosen, view), self.config)
        more._looks, more._trust, more._disagreement = self._looks, self._trust, self._disagreement
        return more

    def look(self, candidate: View) -> Look:
        """What a candidate would see."""
        return self.look_at_all([candidate])[0]

    def look_at_all(self, candidates: Sequence[View]) -> list[Look]:
        """What candidates would see, faster than one after another."""
        return self._look(candidates, self.config.columns)

    def disagreement(self, candidate: View, members: int) -> Float[Tensor, "r"]:
        """Sample variance of the colour of a candidate's rays in the first fields, mean over channels."""
        return self.disagreements([candidate], members)[0]

    def disagreements(self, candidates: Sequence[View], members: int) -> list[Float[Tensor, "r"]]:
        """The same for several candidates, faster than one after another."""
        new = [view for view in dict.fromkeys(candidates) if (view, members) not in self._disagreement]
        for some in _batches(new, self.config.columns):
            seen = self.look_at_all(some)
            origins = torch.cat([one.origins for one in seen])
            directions = torch.cat([one.directions for one in seen])
            colours = [field.render(origins, directions).colour for field in self.fields[:members]]
            variance = torch.stack(colours).var(0).mean(-1).split([len(one.origins) for one in seen])
            self._disagreement |= {(view, members): own for view, own in zip(some, variance, strict=True)}
        return [self._disagreement[view, members] for view in candidates]

    @property
    def chosen_looks(self) -> list[Look]:
        """What each chosen view saw."""
        return self._look(self.chosen, self.config.chosen_columns)

    @cached_property
    def chosen_trust(self) -> Float[Tensor, "chosen cells"]:
        """Mean certainty of the rays of each chosen view that see each cell, 0 where none does."""
        for view, seen in zip(self.chosen, self.chosen_looks, strict=True):
            if view not in self._trust:
                self._trust[view] = seen.trust_in_cells(self.grid.cells)
        rows = [self._trust[view] for view in self.chosen]
        return torch.stack(rows) if rows else torch.zeros(0, self.grid.cells)

    def _look(self, views: Sequence[View], columns: int) -> list[Look]:
        config = self.config
        coarse = min(config.certainty_columns or max(columns // 2, 1), columns)
        new = [view for view in dict.fromkeys(views) if (view, columns) not in self._looks]
        for some in _batches(new, columns):
            found = looks(self.fields[0], self.grid, some, columns, config.colour_variance, coarse)
            self._looks |= {(view, columns): one for view, one in zip(some, found, strict=True)}
        return [self._looks[view, columns] for view in views]


def _batches(views: Sequence[View], columns: int) -> Iterator[list[View]]:
    """As many views as may be looked at together, so that memory does not grow with their number."""
    batch, rays = [], 0
    for view in views:
        own = columns * rows_for(view.camera, columns)
        if batch and rays + own > _RAYS_AT_ONCE:
            yield batch
            batch, rays = [], 0
        batch.append(view)
        rays += own
    if batch:
        yield batch
