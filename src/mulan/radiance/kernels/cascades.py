"""Nested occupancy grids about the centre of the unit cube, each twice as wide as the one inside it.

Cascade k of K covers the cube of side ``2^(k + 1 - K)``; the last covers everything. A point is looked up in
the finest cascade that holds it (instant-ngp, section E), so the middle of a wider one is never consulted.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from mulan.radiance.config import MarchConfig


def consulted_cells(march: MarchConfig) -> Bool[Tensor, "k z y x"]:
    """Cells that no finer cascade covers."""
    side = march.occupancy_resolution
    consulted = torch.ones(march.cascades, side, side, side, dtype=torch.bool)
    inner = slice(side // 4, side - side // 4)
    consulted[1:, inner, inner, inner] = False
    return consulted


def cell_at(unit: Sequence[Float[Tensor, "*b"]], cascades: int, side: int) -> Int[Tensor, "*b"]:
    """Flat index ``x + side·(y + side·(z + side·cascade))`` of the cells that hold unit-cube points.

    Args:
        unit: x, y and z of the points; what lies outside the cube counts as its rim.
        cascades: Number of nested grids.
        side: Cells a side of each.
    """
    magnification = torch.ones_like(unit[0])
    if cascades > 1:
        norm = torch.stack([(u - 0.5).abs() for u in unit]).amax(0)
        for finer in range(1, cascades):
            magnification = torch.where(norm < 0.5**finer / 2, 2.0**finer, magnification)
    x, y, z = ((((u - 0.5) * magnification + 0.5) * side).to(torch.int32).clamp_(0, side - 1) for u in unit)
    cascade = cascades - 1 - magnification.log2().round().to(torch.int32)
    return cascade.mul_(side).add_(z).mul_(side).add_(y).mul_(side).add_(x)


def cell_corners(cells: Int[Tensor, "n"], side: int) -> Int[Tensor, "n 3"]:
    """x, y and z of cells within their cascade, from flat indices."""
    return torch.stack([cells % side, cells // side % side, cells // side**2 % side], -1)


def unit_points(
    cells: Int[Tensor, "n"], within: Float[Tensor, "n 3"], cascades: int, side: int
) -> Float[Tensor, "n 3"]:
    """Points of the unit cube at a place in [0, 1)³ within each cell."""
    magnification = 2.0 ** (cascades - 1 - cells // side**3)
    return ((cell_corners(cells, side) + within) / side - 0.5) / magnification[:, None] + 0.5
