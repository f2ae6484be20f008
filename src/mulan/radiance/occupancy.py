"""Which cells of the unit cube are worth sampling."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.cascades import consulted_cells, unit_points
from mulan.radiance.kernels.march import bounded_step_m, unbounded_step_m
from mulan.radiance.space import SceneSpace

DECAY = 0.95
CELLS_A_REFRESH = 2**15


class OccupancyGrid:
    """A decaying maximum of each cell's opacity over one step (instant-ngp, section E).

    All cells that are consulted are on until ``warm_up`` refreshes have seen the field. A refresh touches a
    random eighth or so of the cells: half drawn from all, half from those that are on.

    Attributes:
        opacity: Running maximum of density times step, indexed [cascade, z, y, x], finest cascade first.
        occupied: Cells to sample; at first all that no finer cascade covers.
        refreshes: How many there have been.
    """

    def __init__(self, march: MarchConfig, space: SceneSpace, warm_up: int = 6) -> None:
        self._consulted = consulted_cells(march)
        self._consulted_cells = self._consulted.view(-1).nonzero()[:, 0]
        self.opacity = torch.zeros(self._consulted.shape)
        self.occupied = self._consulted.clone()
        self.refreshes = 0
        self._warm_up = warm_up
        self._march, self._space = march, space

    @property
    def is_warm(self) -> bool:
        """Whether enough refreshes have seen the field to tell empty from not yet learnt."""
        return self.refreshes >= self._warm_up

    def choose_cells(self, generator: torch.Generator) -> Int[Tensor, "cells"]:
        """Flat cells to refresh next: all that are consulted during the warm-up."""
        cells = self._consulted_cells
        if self.refreshes < self._warm_up or len(cells) <= CELLS_A_REFRESH:
            return cells
        anywhere = cells[torch.randint(len(cells), (CELLS_A_REFRESH // 2,), generator=generator)]
        on = self.occupied.view(-1).nonzero()[:, 0]
        if not len(on):
            return anywhere
        among = on[torch.randint(len(on), (CELLS_A_REFRESH // 2,), generator=generator)]
        return torch.cat([anywhere, among])

    def points_in(self, cells: Int[Tensor, "cells"], generator: torch.Generator) -> Float[Tensor, "cells 3"]:
        """One random point of the unit cube in each cell."""
        within = torch.rand(len(cells), 3, generator=generator)
        return unit_points(cells, within, *self.opacity.shape[:2])

    def step_m(self, unit: Float[Tensor, "cells 3"]) -> Float[Tensor, "cells"]:
        """Step length a ray from the scene centre would take there."""
        if not self._space.unbounded:
            return torch.full((len(unit),), bounded_step_m(self._march, self._space))
        offset = self._space.to_world(unit) - torch.tensor(self._space.centre_m)
        return unbounded_step_m(offset.norm(dim=-1), self._march, self._space.radius_m)

    def refresh(
        self,
        cells: Int[Tensor, "cells"],
        unit: Float[Tensor, "cells 3"],
        density: Float[Tensor, "cells"],
    ) -> None:
        """Take in densities [1/m] at points of the cells and decide anew which are on."""
        value = density * self.step_m(unit)
        flat = self.opacity.view(-1)
        # one maximum a cell first, so that repeated cells decay once
        flat[cells] = flat[cells] * DECAY
        flat.scatter_reduce_(0, cells, value, "amax")
        self.refreshes += 1
        if self.is_warm:
            mean = float(flat.sum() / len(self._consulted_cells))
            threshold = min(self._march.occupancy_threshold, mean)
            self.occupied = self.opacity > threshold
