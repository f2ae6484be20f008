"""Which cells of the unit cube are worth sampling."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.march import bounded_step_m, unbounded_step_m
from mulan.radiance.space import SceneSpace

DECAY = 0.95
CELLS_A_REFRESH = 2**15


class OccupancyGrid:
    """A decaying maximum of each cell's opacity over one step (instant-ngp, section E).

    All cells are on until ``warm_up`` refreshes have seen the field. A refresh touches a random eighth or so
    of the cells: half drawn from all, half from those that are on.

    Attributes:
        opacity: Running maximum of density times step, indexed [z, y, x].
        occupied: Cells to sample.
        refreshes: How many there have been.
    """

    def __init__(self, march: MarchConfig, space: SceneSpace, warm_up: int = 6) -> None:
        side = march.occupancy_resolution
        self.opacity = torch.zeros(side, side, side)
        self.occupied = torch.ones(side, side, side, dtype=torch.bool)
        self.refreshes = 0
        self._warm_up = warm_up
        self._march, self._space = march, space

    @property
    def is_warm(self) -> bool:
        """Whether enough refreshes have seen the field to tell empty from not yet learnt."""
        return self.refreshes >= self._warm_up

    def choose_cells(self, generator: torch.Generator) -> Int[Tensor, "cells"]:
        """Flat cells to refresh next: all of them during the warm-up."""
        cells = self.opacity.numel()
        if self.refreshes < self._warm_up or cells <= CELLS_A_REFRESH:
            return torch.arange(cells)
        anywhere = torch.randint(cells, (CELLS_A_REFRESH // 2,), generator=generator)
        on = self.occupied.view(-1).nonzero()[:, 0]
        if not len(on):
            return anywhere
        among = on[torch.randint(len(on), (CELLS_A_REFRESH // 2,), generator=generator)]
        return torch.cat([anywhere, among])

    def points_in(self, cells: Int[Tensor, "cells"], generator: torch.Generator) -> Float[Tensor, "cells 3"]:
        """One random point of the unit cube in each cell."""
        side = self.opacity.shape[0]
        corner = torch.stack([cells % side, cells // side % side, cells // side**2], -1)
        return (corner + torch.rand(len(cells), 3, generator=generator)) / side

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
            threshold = min(self._march.occupancy_threshold, float(flat.mean()))
            self.occupied = self.opacity > threshold
