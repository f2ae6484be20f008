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
    preview_threshold_factor: float = 5.0
    """A preview skips cells that hold less than so many times what keeps a cell on..."""
    preview_opacity_factor: float = 2.0
    """...and, of an unbounded scene, samples of less than so many times the opacity of those rendered."""


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
        self._preview_words = torch.zeros_like(self._words)
        self._preview: NativeOccupancy | None = None
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
            torch.gt(self.opacity, self._threshold(), out=self.occupied)
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

    def without_nearly_clear(self) -> NativeOccupancy:
        """The grid for previews; made when first asked for after a change."""
        if self.refreshes < self._config.warm_up_refreshes:
            return self.native
        if self._preview is None:
            threshold = self._config.preview_threshold_factor * self._threshold()
            self._preview = NativeOccupancy(
                words=address(self._preview_words),
                least_opacity=self._config.preview_opacity_factor * self._march.least_opacity,
            )
            self._pack_into(self._preview, self.occupied & (self.opacity > threshold))
        return self._preview

    def _threshold(self) -> float:
        mean = float(self.opacity.sum() / self._consulted.sum())
        return min(self._march.occupancy_threshold, mean)

    def _pack(self) -> None:
        self._preview = None
        self._pack_into(self.native, self.occupied)

    def _pack_into(self, native: NativeOccupancy, occupied: Tensor) -> None:
        check(
            self._c.mulan_occupancy_pack(
                self._march.occupancy_resolution,
                self._march.cascades,
                address(occupied),
                native.words,
                ctypes.addressof(native.lower),
                ctypes.addressof(native.upper),
            )
        )
