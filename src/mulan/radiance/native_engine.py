"""The radiance field in C++: same parameters, same answers and same saved state as the torch reference."""

import weakref
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch, RaySamples, Rendering, StepReport
from mulan.radiance.finite import check_finite, check_finite_batch, check_finite_rays
from mulan.radiance.kernels.native_buffers import address, native_field, native_scene
from mulan.radiance.kernels.native_grid import NativeGrid, NativeGridConfig
from mulan.radiance.kernels.native_library import NativeLibrary, check, find_native_library
from mulan.radiance.kernels.native_objective import native_objective
from mulan.radiance.kernels.native_structures import (
    NativeAdam,
    NativeGradients,
    NativeObjective,
    NativeOccupancy,
    NativeParameters,
    NativePoses,
    NativeRays,
    NativeRendering,
    NativeStepReport,
)
from mulan.radiance.networks import RadianceField
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.ray_gradients import RayGradients, native_poses
from mulan.radiance.space import SceneSpace
from mulan.radiance.split_step import BatchPart, ParameterGradients, SplitStepEngine

# Networks in the order in which the library keeps them, one after another.
NETWORKS = (
    "density_hidden",
    "density_out",
    "colour_hidden_0",
    "colour_hidden_1",
    "colour_out",
    "variance_out",
)


@dataclass(frozen=True)
class NativeConfig:
    """How the native engine runs."""

    threads: int = 0
    """Threads to use; 0 = as many as torch would. Results do not depend on it."""
    update_untouched: bool = False
    """Whether table entries without gradient still move by their momentum, as in the reference (slower)."""
    occupancy: NativeGridConfig = field(default_factory=NativeGridConfig)
    """How the occupancy grid is kept up to date."""


class NativeEngine(SplitStepEngine):
    """The field trained and rendered by libmulan_native.

    Same arguments and batches give the same numbers bit for bit, whatever the number of threads.
    """

    def __init__(
        self,
        field: FieldConfig,
        march: MarchConfig,
        space: SceneSpace,
        white_background: bool,
        seed: int = 0,
        optimiser: OptimiserConfig | None = None,
        native: NativeConfig | None = None,
        library: NativeLibrary | None = None,
    ) -> None:
        """An untrained field, equal to the torch engine's of the same seed.

        Args:
            field: Sizes; two features an entry.
            march: Sampling.
            space: Where the field lives.
            white_background: What rays that hit nothing see: white, or black.
            seed: Of the initial parameters and of the sampling.
            optimiser: Learning rates and loss.
            native: How to run.
            library: The library to use; found if not given.

        Raises:
            RuntimeError: There is no library; the message says where it was looked for.
            ValueError: The library cannot hold such a field.
        """
        if library is None:
            library, reason = find_native_library()
            if library is None:
                raise RuntimeError(f"the native engine needs its library: {reason}")
        self.field_config, self.march_config, self.space = field, march, space
        self.optimiser_config = optimiser or OptimiserConfig()
        self.native_config = native or NativeConfig()
        self._c = library.functions
        self._generator = torch.Generator().manual_seed(seed)
        self._field = native_field(field)
        self._scene = native_scene(march, space, white_background)
        workspace = self._c.mulan_workspace_create(self.native_config.threads or torch.get_num_threads())
        if not workspace:
            raise MemoryError("the native engine gets no workspace: too little memory, or too many threads")
        self._workspace = workspace
        weakref.finalize(self, self._c.mulan_workspace_destroy, workspace)

        initial = RadianceField(field, self._generator)
        self._table = initial.table.detach().contiguous()
        self._network_shapes = [tuple(getattr(initial, name).shape) for name in NETWORKS]
        self._networks = torch.cat([getattr(initial, name).detach().flatten() for name in NETWORKS])
        self._table_moments = torch.zeros(2, *self._table.shape)
        self._network_moments = torch.zeros(2, *self._networks.shape)
        self._grid = NativeGrid(march, self.native_config.occupancy, self._c)
        self._steps = 0

    @property
    def occupied_share(self) -> float:
        """Share of the occupancy cells in use that rays are sampled in."""
        return self._grid.occupied_share

    def set_level_weights(self, weights: Float[Tensor, "levels"]) -> None:
        """Scale each level's features (coarse-to-fine); a level of weight 0 neither acts nor learns."""
        if len(weights) != self.field_config.levels or not bool(torch.isfinite(weights).all()):
            raise ValueError(f"{self.field_config.levels} finite weights are needed")
        self._field.level_weight[: len(weights)] = weights.tolist()

    def train_step(self, batch: RayBatch, learning_rate_factor: float) -> StepReport:
        """One optimiser step; see :class:`RadianceEngine`."""
        return self._train(batch, learning_rate_factor)

    def train_step_with_ray_gradients(
        self, batch: RayBatch, learning_rate_factor: float
    ) -> tuple[StepReport, RayGradients]:
        """One optimiser step, and the gradient of its loss to the rays as it was before the step."""
        gradients = RayGradients(torch.zeros_like(batch.origins), torch.zeros_like(batch.directions))
        return self._train(batch, learning_rate_factor, gradients), gradients

    @property
    def parameter_count(self) -> int:
        """See :class:`SplitStepEngine`; the table comes first."""
        return self._table.numel() + self._networks.numel()

    def gradients(
        self, batch: RayBatch, part: BatchPart | None = None, out: Float[Tensor, "parameters"] | None = None
    ) -> tuple[ParameterGradients, StepReport]:
        """First half of a step; see :class:`SplitStepEngine`."""
        values = torch.empty(self.parameter_count) if out is None else out
        first = part.first if part else 0
        check_finite_batch(batch)
        rays, _keep = self._rays(batch.origins, batch.directions, self._new_seed(), first)
        objective, _kept = native_objective(batch, self.optimiser_config, self._scene, self._generator, part)
        table, networks = values.split([self._table.numel(), self._networks.numel()])
        wanted = NativeGradients(table=address(table), networks=address(networks), fresh=1)
        report = NativeStepReport()
        parameters = self._parameters()
        check(self._c.mulan_gradients(*self._context(), parameters, rays, objective, wanted, None, report))
        weight = float(batch.weights.clamp_min(0).sum())
        return ParameterGradients(values, weight, report.rays), _step_report(report)

    def apply(self, gradients: ParameterGradients, learning_rate_factor: float) -> None:
        """Second half of a step; see :class:`SplitStepEngine`."""
        optimiser, skip = self.optimiser_config, not self.native_config.update_untouched
        table, networks = gradients.values.split([self._table.numel(), self._networks.numel()])
        rate = optimiser.table_learning_rate * learning_rate_factor
        mean, square = self._table_moments
        gradient = table.view_as(self._table)
        for level in range(self.field_config.levels):
            if self._field.level_weight[level] != 0:
                self._adam(self._table[level], mean[level], square[level], gradient[level], rate, skip)
        rate = optimiser.network_learning_rate * learning_rate_factor
        mean, square = self._network_moments
        self._adam(self._networks, mean, square, networks, rate, False)
        self._finish_step()

    def _adam(
        self, value: Tensor, mean: Tensor, square: Tensor, gradient: Tensor, rate: float, skip: bool
    ) -> None:
        arrays = (address(x) for x in (value, mean, square, gradient))
        o = self.optimiser_config
        constants = o.beta1, o.beta2, o.epsilon
        check(self._c.mulan_adam(value.numel(), *arrays, rate, *constants, self._steps + 1, skip))

    def train_step_with_pose_gradients(
        self, batch: RayBatch, learning_rate_factor: float, R_world_camera: Float[Tensor, "images 3 3"]
    ) -> tuple[StepReport, Float[Tensor, "images 6"]]:
        """One optimiser step, and the gradient of its loss, before the step, to each image's camera pose.

        Args:
            batch: Rays, of images numbered as the rotations are.
            learning_rate_factor: Scales the base learning rates.
            R_world_camera: Rotations of the cameras the rays start from.

        Returns:
            What the step did, and the gradient to a right perturbation (rotation rad, translation m), summed
            in the order of the rays.

        Raises:
            ValueError: A ray's image has no rotation; nothing was changed.
        """
        poses, out, _keep = native_poses(batch.image_index, R_world_camera)
        return self._train(batch, learning_rate_factor, poses=poses), out

    def ray_gradients(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        colour_gradient: Float[Tensor, "r 3"],
    ) -> tuple[Rendering, RayGradients]:
        """A rendering, and what a gradient to its colours means for the rays; the field stays as it is."""
        check_finite("colour gradients", colour_gradient)
        colour_gradient = colour_gradient.contiguous()
        rays, keep = self._rays(origins, directions)
        rendering, c_rendering = self._empty_rendering(len(origins))
        gradients = RayGradients(torch.zeros_like(keep[0]), torch.zeros_like(keep[1]))
        objective = NativeObjective(
            colour_gradient=address(colour_gradient, (len(origins), 3)), rays_a_pixel=1
        )
        out = NativeGradients(origins=address(gradients.origins), directions=address(gradients.directions))
        given = *self._context(), self._parameters(), rays, objective
        check(self._c.mulan_gradients(*given, out, c_rendering, NativeStepReport()))
        return rendering, gradients

    def parameter_gradient(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        colour_gradient: Float[Tensor, "r 3"],
    ) -> Float[Tensor, "parameters"]:
        """See :class:`SplitStepEngine`."""
        check_finite("colour gradients", colour_gradient)
        gradient = colour_gradient.contiguous()
        rays, _keep = self._rays(origins, directions)
        objective = NativeObjective(colour_gradient=address(gradient, (len(origins), 3)), rays_a_pixel=1)
        values = torch.empty(self.parameter_count)
        table, networks = values.split([self._table.numel(), self._networks.numel()])
        out = NativeGradients(table=address(table), networks=address(networks), fresh=1)
        given = *self._context(), self._parameters(), rays, objective
        check(self._c.mulan_gradients(*given, out, None, NativeStepReport()))
        return values

    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """Colour, depth, opacity and colour variance along rays; see :class:`RadianceEngine`.

        The depth is the blend's mean distance, 0 where nothing is hit.
        """
        return self._render(origins, directions, self._grid.native)

    def preview(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """A rendering without cells and samples that are nearly clear; see :class:`RadianceEngine`."""
        return self._render(origins, directions, self._grid.without_nearly_clear())

    def _render(self, origins: Tensor, directions: Tensor, occupancy: NativeOccupancy) -> Rendering:
        rays, _keep = self._rays(origins, directions)
        rendering, c_rendering = self._empty_rendering(len(origins))
        parts = self._workspace, self._field, self._scene, occupancy, self._parameters()
        check(self._c.mulan_render(*parts, rays, c_rendering))
        return rendering

    def sample(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> RaySamples:
        """The samples a rendering is made of; see :class:`RadianceEngine`."""
        rays, _keep = self._rays(origins, directions)
        marched = torch.zeros(len(origins), dtype=torch.int32)
        check(self._c.mulan_march(self._scene, self._grid.native, rays, 0, address(marched), None, None))
        offsets = torch.zeros(len(origins) + 1, dtype=torch.int64)
        offsets[1:] = marched.cumsum(0)
        room = int(offsets[-1])
        kept = torch.zeros(len(origins), dtype=torch.int32)
        blend, variance, distance = torch.zeros(3, room).unbind(0)
        colour = torch.zeros(room, 3)
        check(
            self._c.mulan_sample(
                *self._context(),
                self._parameters(),
                rays,
                *(address(x) for x in (offsets, kept, blend, colour, variance, distance)),
            )
        )
        ray = torch.arange(len(origins)).repeat_interleave(marched)
        reached = torch.arange(room) < (offsets[:-1] + kept)[ray]
        return RaySamples(*(x[reached] for x in (ray, blend, colour, variance, distance)))

    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """Density [1/m] at world points, 0 outside a bounded scene."""
        unit = self.space.to_unit(points)
        inside = ((unit >= 0) & (unit <= 1)).all(-1)
        unit = unit.contiguous()
        out = torch.empty(len(points))
        check(
            self._c.mulan_density(
                self._workspace, self._field, self._parameters(), len(points), address(unit), address(out)
            )
        )
        return torch.where(inside, out / self.space.radius_m, 0.0)

    def state(self) -> dict[str, Tensor]:
        """Copies of all that changes; names and shapes are the torch engine's, so either reads the other."""
        moments = zip(self._table_moments, self._network_moments, strict=True)
        prefixes = ("", "exp_avg.", "exp_avg_sq.")
        parts = [(self._table, self._networks), *moments]
        state = {}
        for prefix, (table, networks) in zip(prefixes, parts, strict=True):
            state[f"{prefix}table"] = table.clone()
            sizes = [rows * columns for rows, columns in self._network_shapes]
            for name, shape, flat in zip(NETWORKS, self._network_shapes, networks.split(sizes), strict=True):
                state[prefix + name] = flat.view(shape).clone()
        state["occupancy.opacity"] = self._grid.opacity.clone()
        state["occupancy.occupied"] = self._grid.occupied.clone()
        state["counters"] = torch.tensor([self._steps, self._grid.refreshes])
        state["generator"] = self._generator.get_state()
        return state

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` gave; see :class:`RadianceEngine`."""
        self.check_state(state)
        for prefix, table, networks in (
            ("", self._table, self._networks),
            ("exp_avg.", self._table_moments[0], self._network_moments[0]),
            ("exp_avg_sq.", self._table_moments[1], self._network_moments[1]),
        ):
            table.copy_(state[f"{prefix}table"])
            networks.copy_(torch.cat([state[prefix + name].flatten() for name in NETWORKS]))
        self._steps, refreshes = (int(x) for x in state["counters"])
        self._grid.restore(state["occupancy.opacity"], state["occupancy.occupied"], refreshes)
        self._generator.set_state(state["generator"])

    def _train(
        self,
        batch: RayBatch,
        factor: float,
        gradients: RayGradients | None = None,
        poses: NativePoses | None = None,
    ) -> StepReport:
        check_finite_batch(batch)
        rays, _keep = self._rays(batch.origins, batch.directions, self._new_seed())
        optimiser, config = self.optimiser_config, self.native_config
        objective, _kept = native_objective(batch, optimiser, self._scene, self._generator)
        adam = NativeAdam(
            *(address(m) for m in (*self._table_moments, *self._network_moments)),
            optimiser.table_learning_rate * factor,
            optimiser.network_learning_rate * factor,
            *(optimiser.beta1, optimiser.beta2, optimiser.epsilon),
            self._steps + 1,
            not config.update_untouched,
        )
        report = NativeStepReport()
        ray_gradients = (
            (None, None) if gradients is None else (address(gradients.origins), address(gradients.directions))
        )
        check(
            self._c.mulan_train_step(
                *self._context(),
                address(self._table),
                address(self._networks),
                rays,
                objective,
                adam,
                *ray_gradients,
                poses,
                report,
            )
        )
        self._finish_step()
        return _step_report(report)

    def _finish_step(self) -> None:
        self._steps += 1
        if self._steps % self.optimiser_config.occupancy_every == 0:
            parts = self._workspace, self._field, self._scene, self._parameters()
            self._grid.refresh(*parts, self._new_seed())

    def _new_seed(self) -> int:
        return int(torch.randint(2**62, (), generator=self._generator))

    def _context(self) -> tuple:
        return self._workspace, self._field, self._scene, self._grid.native

    def _parameters(self) -> NativeParameters:
        return NativeParameters(address(self._table), address(self._networks))

    def _rays(
        self, origins: Tensor, directions: Tensor, seed: int | None = None, first: int = 0
    ) -> tuple[NativeRays, tuple]:
        """Rays for a call, and the arrays that must outlive it; without a seed samples lie mid-step."""
        origins, directions = origins.contiguous(), directions.contiguous()
        shape = (len(origins), 3)
        at = address(origins, shape), address(directions, shape)
        check_finite_rays(origins, directions)
        rays = NativeRays(len(origins), *at, seed or 0, seed is not None, first)
        return rays, (origins, directions)

    @staticmethod
    def _empty_rendering(rays: int) -> tuple[Rendering, NativeRendering]:
        colour, scalars = torch.empty(rays, 3), torch.empty(3, rays).unbind(0)
        return Rendering(colour, *scalars), NativeRendering(address(colour), *(address(x) for x in scalars))


def _step_report(report: NativeStepReport) -> StepReport:
    return StepReport(report.loss, report.squared_error / max(report.rays, 1), report.samples)
