"""What views see of the scene as a field has it, and how far their poses let each ray be trusted."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.planning.cells import CellGrid
from mulan.planning.rays import camera_rays, rows_for
from mulan.planning.score import CandidateView, pose_colour_variances
from mulan.planning.view import View
from mulan.radiance.engine import RadianceEngine

LEAST_BLEND = 0.1  # of a ray's light must come from a cell for the ray to have seen it


@dataclass(frozen=True)
class SeenCells:
    """The cells of a look, each once.

    Attributes:
        cell: Their numbers, increasing.
        of_sight: Place of each sight's cell among them.
        sights: How many each has.
    """

    cell: Int[Tensor, "seen"]
    of_sight: Int[Tensor, "sights"]
    sights: Int[Tensor, "seen"]


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

    @cached_property
    def seen(self) -> SeenCells:
        """The cells, each once."""
        return SeenCells(*torch.unique(self.cell, return_inverse=True, return_counts=True))

    def trust_in_cells(self, cells: int) -> Float[Tensor, "cells"]:
        """Mean certainty of the rays that see each cell, 0 where none does."""
        total = torch.zeros(cells).index_add(0, self.cell, self.certainty[self.ray])
        return total / torch.bincount(self.cell, minlength=cells).clamp_min(1)

    def per_ray(self, of_cell: Float[Tensor, "sights"]) -> Float[Tensor, "r"]:
        """A value of each sight's cell, shared evenly by the rays that see the cell, summed over each ray."""
        shared = of_cell / self.seen.sights[self.seen.of_sight]
        return torch.zeros(len(self.origins)).index_add(0, self.ray, shared)


def looks(
    engine: RadianceEngine,
    grid: CellGrid,
    views: Sequence[View],
    columns: int,
    colour_variance: float,
    certainty_columns: int,
) -> list[Look]:
    """Cast the rays of several views into the field at once: small calls cost more to begin than to do.

    Args:
        engine: The field.
        grid: Cells to count sights in.
        views: The views.
        columns: Rays across each image.
        colour_variance: s₀², what a colour is off by at an exact pose; the certainty of a ray is
            ``s₀²/(s₀² + v)`` with v the colour variance under the pose's covariance (sigma points).
        certainty_columns: Rays across the image that v is worked out for; the others take the nearest one's.
    """
    if not views:
        return []
    rays = [camera_rays(view.camera, view.T_world_camera, columns) for view in views]
    origins = torch.cat([own for own, _ in rays])
    directions = torch.cat([own for _, own in rays])
    samples = engine.sample(origins, directions)
    points = origins[samples.ray_index] + samples.distance_m[:, None] * directions[samples.ray_index]
    pair = samples.ray_index * grid.cells + grid.cell_of(points)
    pairs, number = torch.unique(pair, return_inverse=True)
    blend = torch.zeros(len(pairs)).index_add(0, number, samples.blend)
    pairs = pairs[blend >= LEAST_BLEND]
    ray, cell = pairs // grid.cells, pairs % grid.cells
    variances = pose_colour_variances(
        engine, [CandidateView(v.camera, v.T_world_camera, v.covariance, certainty_columns) for v in views]
    )
    found, first = [], 0
    for view, (own_origins, own_directions), coarse in zip(views, rays, variances, strict=True):
        begin, end = torch.searchsorted(ray, torch.tensor([first, first + len(own_origins)])).tolist()
        v = _spread(coarse, view, columns, certainty_columns)
        certainty = colour_variance / (colour_variance + v)
        own = ray[begin:end] - first
        found.append(Look(own_origins, own_directions, certainty, own, cell[begin:end]))
        first += len(own_origins)
    return found


def _spread(v: Float[Tensor, "c"], view: View, columns: int, coarse: int) -> Float[Tensor, "r"]:
    """What was worked out for fewer rays each way, which is much less work."""
    rows, coarse_rows = rows_for(view.camera, columns), rows_for(view.camera, coarse)
    row = torch.arange(rows) * coarse_rows // rows
    column = torch.arange(columns) * coarse // columns
    return v.view(coarse_rows, coarse)[row][:, column].reshape(-1)
