"""A hash-grid field as one would first write it in torch: the yardstick for every faster one.

Autograd does all the work: corners are fetched by ``index_select``, every ray is cut into all its steps, the
field is asked wherever the occupancy grid says so, light is a ``cumsum`` over a dense rays × steps array.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.config import FieldConfig
from mulan.radiance.engine import RayBatch, Rendering, StepReport
from mulan.radiance.kernels.cascades import cell_at
from mulan.radiance.kernels.hash_encoding import HashEncoding, corner_index
from mulan.radiance.kernels.march import bounded_step_m, box_interval, step_count
from mulan.radiance.networks import RadianceField
from mulan.radiance.occupancy import OccupancyGrid
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.reconstruction.field_file import FieldDescription

RAYS_AT_ONCE = 2048
_CORNERS = torch.tensor([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


def encode_plainly(
    points: Float[Tensor, "n 3"], table: Float[Tensor, "levels entries features"], config: FieldConfig
) -> Float[Tensor, "n encoded"]:
    """Trilinear blend of the 8 corners, level by level; differentiable in the table."""
    encoded = []
    for level in range(config.levels):
        resolution = config.level_resolution(level)
        scaled = points * resolution
        cell = scaled.floor().long().clamp(0, resolution - 1)
        fraction = (scaled - cell)[:, None]
        weight = torch.where(_CORNERS.bool(), fraction, 1 - fraction).prod(-1)
        entry = corner_index(
            cell[:, None] + _CORNERS, resolution, config.level_is_dense(level), table.shape[1]
        )
        rows = table[level].index_select(0, entry.reshape(-1)).view(len(points), 8, -1)
        encoded.append((weight[..., None] * rows).sum(1))
    return torch.cat(encoded, -1)


class PlainEncoding(HashEncoding):
    """:func:`encode_plainly` where a field expects its encoding."""

    def __call__(
        self, points: Float[Tensor, "n 3"], table: Float[Tensor, "levels entries features"]
    ) -> Float[Tensor, "n encoded"]:
        """The encoding of unit-cube points."""
        return encode_plainly(points, table, self.config)


class NaiveTorchField:
    """Learns a bounded scene by squared errors and renders it; parameters and sizes are ``TorchEngine``'s."""

    def __init__(
        self, description: FieldDescription, seed: int = 0, optimiser: OptimiserConfig | None = None
    ) -> None:
        """An untrained field.

        Raises:
            ValueError: The scene is unbounded.
        """
        if description.space.unbounded:
            raise ValueError("the naive field knows bounded scenes only")
        self._description, self._optimiser = description, optimiser or OptimiserConfig()
        self._generator = torch.Generator().manual_seed(seed)
        self.field = RadianceField(description.field, self._generator)
        # the networks are plain torch as they are; only the encoding is replaced
        self.field.encoding = PlainEncoding(description.field)
        self._occupancy = OccupancyGrid(description.march, description.space)
        networks = [p for name, p in self.field.named_parameters() if name != "table"]
        groups = [{"params": [self.field.table]}, {"params": networks}]
        adam = self._optimiser
        self._adam = torch.optim.Adam(groups, betas=(adam.beta1, adam.beta2), eps=adam.epsilon)
        self._steps = 0

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Take over parameters, moments and occupancy of an engine's saved state."""
        self._steps, self._occupancy.refreshes = (int(x) for x in state["counters"])
        with torch.no_grad():
            for name, parameter in self.field.named_parameters():
                parameter.copy_(state[name])
                self._adam.state[parameter] = {
                    "step": torch.tensor(float(self._steps)),
                    "exp_avg": state[f"exp_avg.{name}"].clone(),
                    "exp_avg_sq": state[f"exp_avg_sq.{name}"].clone(),
                }
        self._occupancy.opacity = state["occupancy.opacity"].clone()
        self._occupancy.occupied = state["occupancy.occupied"].clone()

    def train_step(self, batch: RayBatch, learning_rate_factor: float) -> StepReport:
        """One optimiser step on weighted squared errors and the variance head's likelihood."""
        rendering, marched = self._render_dense(
            batch.origins, batch.directions, torch.rand(len(batch.origins), generator=self._generator)
        )
        squared = (rendering.colour - batch.colours).square().mean(-1)
        share = batch.weights / batch.weights.sum()
        loss = (share * squared).sum()
        variance = rendering.variance + 1e-4
        likelihood = (share * 0.5 * (squared.detach() / variance + variance.log())).sum()
        self._adam.zero_grad()
        (loss + likelihood).backward()
        rates = (self._optimiser.table_learning_rate, self._optimiser.network_learning_rate)
        for group, rate in zip(self._adam.param_groups, rates, strict=True):
            group["lr"] = rate * learning_rate_factor
        self._adam.step()
        self._steps += 1
        if self._steps % self._optimiser.occupancy_every == 0:
            self._refresh_occupancy()
        return StepReport(float(loss.detach()), float(squared.detach().mean()), marched)

    @torch.no_grad()
    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """Colour, depth, opacity and colour variance along rays."""
        parts = [
            self._render_dense(o, d, torch.full((len(o),), 0.5))[0]
            for o, d in zip(origins.split(RAYS_AT_ONCE), directions.split(RAYS_AT_ONCE), strict=True)
        ]
        names = ("colour", "depth_m", "opacity", "variance")
        return Rendering(*(torch.cat([getattr(part, name) for part in parts]) for name in names))

    def _render_dense(self, origins: Tensor, directions: Tensor, jitter: Tensor) -> tuple[Rendering, int]:
        space, march, occupied = self._description.space, self._description.march, self._occupancy.occupied
        steps, step_m = step_count(march), bounded_step_m(march, space)
        enter, leave = box_interval(origins, directions, space)
        distance = enter[:, None] + (torch.arange(steps) + jitter[:, None]) * step_m
        points = origins[:, None] + distance[..., None] * directions[:, None]
        unit = space.to_unit(points.view(-1, 3)).view(points.shape)
        cell = cell_at(unit.unbind(-1), *occupied.shape[:2])
        ray, step = (occupied.view(-1)[cell] & (distance < leave[:, None])).nonzero(as_tuple=True)

        density, hidden, features = self.field.geometry(unit[ray, step])
        optical_depth = torch.zeros(distance.shape)
        optical_depth = optical_depth.index_put((ray, step), density * (step_m / space.radius_m))
        reach = torch.exp(-(optical_depth.cumsum(1) - optical_depth))
        blend = reach * (1 - torch.exp(-optical_depth))
        colour = torch.zeros(points.shape)
        colour = colour.index_put((ray, step), self.field.colour(features, directions[ray]))
        variance = torch.zeros(distance.shape)
        variance = variance.index_put((ray, step), self.field.variance(hidden, features))

        opacity = blend.sum(1)
        seen = (blend[..., None] * colour).sum(1)
        if self._description.white_background:
            seen = seen + (1 - opacity)[:, None]
        depth_m = (blend * distance).sum(1) / opacity.clamp_min(1e-10)
        return Rendering(seen, depth_m, opacity, (blend.detach().square() * variance).sum(1)), len(ray)

    @torch.no_grad()
    def _refresh_occupancy(self) -> None:
        cells = self._occupancy.choose_cells(self._generator)
        unit = self._occupancy.points_in(cells, self._generator)
        density = torch.cat([self.field.geometry(chunk)[0] for chunk in unit.split(2**17)])
        self._occupancy.refresh(cells, unit, density / self._description.space.radius_m)
