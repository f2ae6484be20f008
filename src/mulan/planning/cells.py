"""The scene cut into cells, to count what has been looked at."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.space import SceneSpace

CELLS_A_SIDE = 32  # about one ray of a 25-column view each


@dataclass(frozen=True)
class CellGrid:
    """Equal cells of the unit cube the field lives in.

    Attributes:
        space: Maps the world to the unit cube.
        side: Cells a side.
    """

    space: SceneSpace
    side: int

    @staticmethod
    def of(space: SceneSpace) -> "CellGrid":
        """A grid as fine as a candidate's rays; an unbounded scene has its inside in half of the cube."""
        return CellGrid(space, CELLS_A_SIDE * (2 if space.unbounded else 1))

    @property
    def cells(self) -> int:
        """How many there are."""
        return self.side**3

    def cell_of(self, points_m: Float[Tensor, "n 3"]) -> Int[Tensor, "n"]:
        """Number of the cell each world point lies in; points outside count to the nearest cell."""
        index = (self.space.to_unit(points_m) * self.side).long().clamp(0, self.side - 1)
        return (index[:, 0] * self.side + index[:, 1]) * self.side + index[:, 2]

    def centre_m(self, cell: Int[Tensor, "n"]) -> Float[Tensor, "n 3"]:
        """World position of the middle of cells."""
        x, y, z = cell // self.side**2, cell // self.side % self.side, cell % self.side
        return self.space.to_world((torch.stack([x, y, z], -1) + 0.5) / self.side)
