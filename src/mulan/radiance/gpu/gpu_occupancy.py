"""The occupancy grid on the GPU: which cells of the unit cube rays are sampled in."""

from collections.abc import Callable
from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.gpu.random_kernels import CELL_X, split_seed, uniform
from mulan.radiance.kernels.cascades import consulted_cells, unit_points
from mulan.radiance.kernels.march import bounded_step_m, unbounded_step_m
from mulan.radiance.space import SceneSpace


@triton.jit(do_not_specialize=["n", "seed_low", "seed_high"])
@no_type_check
def cell_points_kernel(
    cells,
    within,
    n,
    seed_low,
    seed_high,
    X: tl.constexpr,
    B: tl.constexpr,
):
    """A random place in [0, 1)³ within each cell."""
    i = tl.program_id(0) * B + tl.arange(0, B)
    on = i < n
    cell = tl.load(cells + i, mask=on, other=0)
    for axis in tl.static_range(3):
        tl.store(within + 3 * i + axis, uniform(seed_low, seed_high, cell, X + axis), mask=on)


class GpuGrid:
    """A decaying maximum of each cell's opacity over one step (instant-ngp, section E).

    The same cells are visited at the same points as by the native engine's grid.

    Attributes:
        opacity: Running maximum of density times step, indexed [cascade, z, y, x], finest cascade first.
        occupied: Cells to sample; at first all that no finer cascade covers.
        refreshes: How many there have been.
    """

    def __init__(
        self, march: MarchConfig, space: SceneSpace, config: TritonConfig, device: torch.device
    ) -> None:
        consulted = consulted_cells(march).to(device)
        self.opacity = torch.zeros(consulted.shape, device=device)
        self.occupied = consulted.clone()
        self.refreshes = 0
        self._march, self._space, self._config = march, space, config
        self._cells = consulted.view(-1).nonzero()[:, 0].int()

    @property
    def occupied_share(self) -> float:
        """Share of the cells in use that are on."""
        return float(self.occupied.sum()) / len(self._cells)

    @property
    def is_warm(self) -> bool:
        """Whether enough refreshes have seen the field to tell empty from not yet learnt."""
        return self.refreshes >= self._config.occupancy.warm_up_refreshes

    def refresh(
        self, density: Callable[[Float[Tensor, "3 room"], int], Float[Tensor, "room"]], seed: int
    ) -> None:
        """Look at some cells' density again and decide anew which are on.

        Args:
            density: Densities per scene radius of the first so many of some unit points.
            seed: Where in its cell each point lies.
        """
        config, most = self._config.occupancy, self._config.wave_samples
        for cells in self._visited().split(most):
            unit = self._points(cells, seed)
            value = density(unit, len(cells))[: len(cells)] * self._step_in_radii(unit[:, : len(cells)].T)
            flat, at = self.opacity.view(-1), cells.long()
            flat[at] = torch.maximum(flat[at] * config.decay, value)
        self.refreshes += 1
        if self.is_warm:
            mean = self.opacity.sum() / len(self._cells)
            threshold = mean.clamp_max(self._march.occupancy_threshold)
            torch.gt(self.opacity, threshold, out=self.occupied)

    def restore(self, opacity: Tensor, occupied: Tensor, refreshes: int) -> None:
        """Go on from saved cells."""
        self.opacity.copy_(opacity)
        self.occupied.copy_(occupied)
        self.refreshes = refreshes

    def _visited(self) -> Int[Tensor, "cells"]:
        """All cells in use during the warm-up; then one in so many, and one in fewer of those that are on."""
        if not self.is_warm:
            return self._cells
        config, cell = self._config.occupancy, self._cells
        anywhere = cell % config.cell_stride == self.refreshes % config.cell_stride
        stride = config.occupied_cell_stride
        occupied = self.occupied.view(-1)[cell.long()]
        return cell[anywhere | (occupied & (cell % stride == self.refreshes % stride))]

    def _points(self, cells: Int[Tensor, "cells"], seed: int) -> Float[Tensor, "3 room"]:
        room = max(programs(len(cells), self._config.room), 1) * self._config.room
        within, block = torch.empty(len(cells), 3, device=cells.device), self._config.blocks.samples
        if len(cells):
            cell_points_kernel[(programs(len(cells), block),)](
                *(cells, within, len(cells), *split_seed(seed), CELL_X, block)
            )
        unit = torch.empty(3, room, device=cells.device)
        unit[:, : len(cells)] = unit_points(cells, within, *self.opacity.shape[:2]).T
        return unit

    def _step_in_radii(self, unit: Float[Tensor, "cells 3"]) -> Float[Tensor, "cells"]:
        """Step length a ray from the scene centre would take there."""
        space = self._space
        if not space.unbounded:
            return unit.new_full((len(unit),), bounded_step_m(self._march, space) / space.radius_m)
        offset = space.to_world(unit) - unit.new_tensor(space.centre_m)
        return unbounded_step_m(offset.norm(dim=-1), self._march, space.radius_m) / space.radius_m
