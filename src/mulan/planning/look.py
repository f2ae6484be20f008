"""What a view sees of the scene as a field has it, and how far its pose lets each ray be trusted."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.planning.cells import CellGrid
from mulan.planning.rays import camera_rays, rows_for
from mulan.planning.score import CandidateView, pose_colour_variance
from mulan.planning.view import View
from mulan.radiance.engine import RadianceEngine

LEAST_BLEND = 0.1  # of a ray's light must come from a cell for the ray to have seen it


@dataclass(frozen=True)
class Look:
    """The rays of one view and the cells they see.

    Attributes:
        origins: World origins of the rays [m].
        directions: Unit world directions.
        certainty: Trust in each ray, in (0, 1]; 1 for an exact pose.
        ray: Ray of each sight, a sight being one ray that sees one cell.
        cell: Cell of each sight.
    """

    origins: Float[Tensor, "r 3"]
    directions: Float[Tensor, "r 3"]
    certainty: Float[Tensor, "r"]
    ray: Int[Tensor, "sights"]
    cell: Int[Tensor, "sights"]

    def trust_in_cells(self, cells: int) -> Float[Tensor, "cells"]:
        """Mean certainty of the rays that see each cell, 0 where none does."""
        total = torch.zeros(cells).index_add(0, self.cell, self.certainty[self.ray])
        return total / torch.bincount(self.cell, minlength=cells).clamp_min(1)

    def per_ray(self, of_cell: Float[Tensor, "sights"]) -> Float[Tensor, "r"]:
        """A value of each sight's cell, shared evenly by the rays that see the cell, summed over each ray."""
        _, number, count = torch.unique(self.cell, return_inverse=True, return_counts=True)
        return torch.zeros(len(self.origins)).index_add(0, self.ray, of_cell / count[number])


def look(
    engine: RadianceEngine,
    grid: CellGrid,
    view: View,
    columns: int,
    colour_variance: float,
    certainty_columns: int,
) -> Look:
    """Cast a view's rays into the field.

    Args:
        engine: The field.
        grid: Cells to count sights in.
        view: The view.
        columns: Rays across its image.
        colour_variance: s₀², what a colour is off by at an exact pose; the certainty of a ray is
            ``s₀²/(s₀² + v)`` with v the colour variance under the pose's covariance (sigma points).
        certainty_columns: Rays across the image that v is worked out for; the others take the nearest one's.
    """
    origins, directions = camera_rays(view.camera, view.T_world_camera, columns)
    samples = engine.sample(origins, directions)
    points = origins[samples.ray_index] + samples.distance_m[:, None] * directions[samples.ray_index]
    pair = samples.ray_index * grid.cells + grid.cell_of(points)
    pairs, number = torch.unique(pair, return_inverse=True)
    blend = torch.zeros(len(pairs)).index_add(0, number, samples.blend)
    pairs = pairs[blend >= LEAST_BLEND]
    v = _colour_variance(engine, view, columns, certainty_columns)
    certainty = colour_variance / (colour_variance + v)
    return Look(origins, directions, certainty, pairs // grid.cells, pairs % grid.cells)


def _colour_variance(engine: RadianceEngine, view: View, columns: int, coarse: int) -> Float[Tensor, "r"]:
    """Under the pose's covariance, from fewer rays each way, which is much less work."""
    v = pose_colour_variance(engine, CandidateView(view.camera, view.T_world_camera, view.covariance, coarse))
    rows, coarse_rows = rows_for(view.camera, columns), rows_for(view.camera, coarse)
    row = torch.arange(rows) * coarse_rows // rows
    column = torch.arange(columns) * coarse // columns
    return v.view(coarse_rows, coarse)[row][:, column].reshape(-1)
