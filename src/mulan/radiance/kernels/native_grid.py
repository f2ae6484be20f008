"""The occupancy grid of the native engine: which cells of the unit cube rays are sampled in."""

import ctypes
from ctypes import CDLL
from dataclasses import dataclass

import torch
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.cascades import consulted_cells
from mulan.radiance.kernels.native_buffers import address
from mulan.radiance.kernels.native_library import check
from mulan.radiance.kernels.native_structures import (
    NativeField,
    NativeOccupancy,
    NativeParameters,
    NativeScene,
)


@dataclass(frozen=True)
class NativeGridConfig:
    """How the occupancy grid is kept up to date."""

    decay: float = 0.95
    """What a visited cell's remembered opacity is multiplied with before it is compared with a new one."""
    warm_up_refreshes: int = 6
    """Refreshes before any cell is switched off; each visits every cell."""
    cell_stride: int = 8
    """A later refresh visits one in so many cells..."""
    occupied_cell_stride: int = 2
    """...and one in so many of the occupied ones."""


class NativeGrid:
    """A decaying maximum of each cell's opacity over one step (instant-ngp, section E).

    Attributes:
        opacity: Running maximum of density times step, indexed [cascade, z, y, x], finest cascade first.
        occupied: Cells to sample; at first all that no finer cascade covers.
        refreshes: How many there have been.
        native: The same as the library reads it.
    """

    def __init__(self, march: MarchConfig, config: NativeGridConfig, functions: CDLL) -> None:
        side = march.occupancy_resolution
        self._consulted = consulted_cells(march)
        self.opacity = torch.zeros(self._consulted.shape)
        self.occupied = self._consulted.clone()
        self.refreshes = 0
        self._words = torch.zeros(march.cascades * (side // 4) ** 3, dtype=torch.int64)
        self.native = NativeOccupancy(words=address(self._words))
        self._march, self._config, self._c = march, config, functions
        self._pack()

    @property
    def occupied_share(self) -> float:
        """Share of the consulted cells that are on."""
        return float(self.occupied.sum() / self._consulted.sum())

    def refresh(
        self, workspace: int, field: NativeField, scene: NativeScene, parameters: NativeParameters, seed: int
    ) -> None:
        """Look at some cells' density again and decide anew which are on."""
        config = self._config
        warming = self.refreshes < config.warm_up_refreshes
        check(
            self._c.mulan_occupancy_refresh(
                *(workspace, field, scene, parameters),
                config.decay,
                1 if warming else config.cell_stride,
                1 if warming else config.occupied_cell_stride,
                self.refreshes,
                seed,
                address(self.occupied),
                address(self.opacity),
            )
        )
        self.refreshes += 1
        if self.refreshes >= config.warm_up_refreshes:
            mean = float(self.opacity.sum() / self._consulted.sum())
            threshold = min(self._march.occupancy_threshold, mean)
            torch.gt(self.opacity, threshold, out=self.occupied)
            self.native.least_opacity = self._march.least_opacity
            self._pack()

    def restore(self, opacity: Tensor, occupied: Tensor, refreshes: int) -> None:
        """Go on from saved cells."""
        self.opacity.copy_(opacity)
        self.occupied.copy_(occupied)
        self.refreshes = refreshes
        if refreshes >= self._config.warm_up_refreshes:
            self.native.least_opacity = self._march.least_opacity
        self._pack()

    def _pack(self) -> None:
        check(
            self._c.mulan_occupancy_pack(
                self._march.occupancy_resolution,
                self._march.cascades,
                address(self.occupied),
                self.native.words,
                ctypes.addressof(self.native.lower),
                ctypes.addressof(self.native.upper),
            )
        )
