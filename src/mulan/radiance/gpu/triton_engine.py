"""The radiance field on a GPU: same parameters, same answers and same saved state as the torch reference."""

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.background import random_background
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RadianceEngine, RayBatch, RaySamples, Rendering, StepReport
from mulan.radiance.finite import check_finite, check_finite_batch, check_finite_rays
from mulan.radiance.gpu.adam_kernel import adam_step
from mulan.radiance.gpu.gpu_field import GpuField
from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.gpu.ray_losses import RayLosses, ray_losses
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.ray_gradients import RayGradients
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import EXPLORING_SHARE


class TritonEngine(RadianceEngine):
    """The field trained and rendered by Triton kernels.

    Random numbers are the native engine's, so both march the same samples. Sums into the table are taken in
    no fixed order, so two trainings agree to rounding only.
    """

    def __init__(
        self,
        field: FieldConfig,
        march: MarchConfig,
        space: SceneSpace,
        white_background: bool,
        seed: int = 0,
        device: torch.device | None = None,
        optimiser: OptimiserConfig | None = None,
        config: TritonConfig | None = None,
    ) -> None:
        """An untrained field, equal to the torch engine's of the same seed.

        Args:
            field: Sizes; the features of an entry are a power of two.
            march: Sampling.
            space: Where the field lives.
            white_background: What rays that hit nothing see: white, or black.
            seed: Of the initial parameters and of the sampling.
            device: The GPU; the current one if not given. In Triton's interpreter, the CPU.
            optimiser: Learning rates and loss.
            config: How to run.

        Raises:
            ValueError: The features of an entry are no power of two.
        """
        if field.features & (field.features - 1):
            raise ValueError(f"features an entry must be a power of two, not {field.features}")
        self.device = device or torch.device("cuda", torch.cuda.current_device())
        self.field_config, self.march_config, self.space = field, march, space
        self.white_background = white_background
        self.optimiser_config = optimiser or OptimiserConfig()
        self.triton_config = config or TritonConfig()
        self._generator = torch.Generator().manual_seed(seed)
        self._field = GpuField(
            *(field, march, space, white_background, self._generator, self.triton_config, self.device)
        )
        self._steps = 0

    @property
    def occupied_share(self) -> float:
        """Share of the occupancy cells in use that rays are sampled in."""
        return self._field.grid.occupied_share

    def set_level_weights(self, weights: Float[Tensor, "levels"]) -> None:
        """Scale each level's features (coarse-to-fine); a level of weight 0 neither acts nor learns."""
        if len(weights) != self.field_config.levels or not bool(torch.isfinite(weights).all()):
            raise ValueError(f"{self.field_config.levels} finite weights are needed")
        self._field.encoding.level_weight.copy_(weights)

    def train_step(self, batch: RayBatch, learning_rate_factor: float) -> StepReport:
        """One optimiser step; see :class:`RadianceEngine`."""
        return self._train(batch, learning_rate_factor, None)

    def train_step_with_ray_gradients(
        self, batch: RayBatch, learning_rate_factor: float
    ) -> tuple[StepReport, RayGradients]:
        """One optimiser step, and the gradient of its loss to the rays as it was before the step."""
        gradients = RayGradients(*(torch.empty_like(x) for x in (batch.origins, batch.directions)))
        return self._train(batch, learning_rate_factor, gradients), gradients

    def train_step_with_pose_gradients(
        self, batch: RayBatch, learning_rate_factor: float, R_world_camera: Float[Tensor, "images 3 3"]
    ) -> tuple[StepReport, Float[Tensor, "images 6"]]:
        """One optimiser step, and the gradient of its loss, before the step, to each image's camera pose.

        Args:
            batch: Rays, of images numbered as the rotations are.
            learning_rate_factor: Scales the base learning rates.
            R_world_camera: Rotations of the cameras the rays start from.

        Returns:
            What the step did, and the gradient to a right perturbation (rotation rad, translation m).

        Raises:
            ValueError: A ray's image has no rotation; nothing was changed.
        """
        image, images = batch.image_index, len(R_world_camera)
        if len(image) and not 0 <= int(image.min()) <= int(image.max()) < images:
            raise ValueError(f"a ray's image is not among the {images} with a rotation")
        report, to_rays = self.train_step_with_ray_gradients(batch, learning_rate_factor)
        turned = torch.cross(batch.directions, to_rays.directions, dim=-1)
        world = torch.zeros(images, 2, 3, device=image.device)
        world.index_add_(0, image.long(), torch.stack([turned, to_rays.origins], 1))
        out = world.to(R_world_camera.device) @ R_world_camera
        return report, out.reshape(images, 6)

    @torch.no_grad()
    def ray_gradients(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        colour_gradient: Float[Tensor, "r 3"],
    ) -> tuple[Rendering, RayGradients]:
        """A rendering, and what a gradient to its colours means for the rays; the field stays as it is."""
        check_finite("colour gradients", colour_gradient)
        o, d = self._rays(origins, directions)
        upstream = colour_gradient.to(self.device).contiguous()
        rendering = _empty_rendering(origins)
        gradients = RayGradients(torch.empty_like(origins), torch.empty_like(directions))
        for wave in self._field.waves(o, d):
            losses = RayLosses.given(upstream[wave.part])
            to_rays = self._field.backward(wave, losses, learn=False, rays=True)
            _copy_rays(to_rays, gradients, wave.part)
            _copy_answers(wave.answers, rendering, wave.part)
        return rendering, gradients

    @torch.no_grad()
    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """Colour, depth, opacity and colour variance along rays; see :class:`RadianceEngine`.

        The depth is the blend's mean distance, 0 where nothing is hit.
        """
        rendering = _empty_rendering(origins)
        for wave in self._field.waves(*self._rays(origins, directions)):
            _copy_answers(wave.answers, rendering, wave.part)
        rendering.colour.clamp_(0, 1)
        return rendering

    @torch.no_grad()
    def sample(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> RaySamples:
        """The samples a rendering is made of; see :class:`RadianceEngine`."""
        parts = []
        for wave in self._field.waves(*self._rays(origins, directions)):
            n = int(wave.reached.count)
            columns = (
                wave.reached.ray[:n].long() + wave.part.start,
                wave.blend[:n],
                wave.seen.colour[:, :n].T,
                wave.seen.variance[:n],
                wave.reached.distance_m[:n],
            )
            parts.append([x.to(origins.device) for x in columns])
        return RaySamples(*(torch.cat(column) for column in zip(*parts, strict=True)))

    @torch.no_grad()
    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """Density [1/m] at world points, 0 outside a bounded scene."""
        parts = []
        for part in points.to(self.device).split(self.triton_config.wave_samples):
            unit = self.space.to_unit(part)
            inside = ((unit >= 0) & (unit <= 1)).all(-1)
            room = programs(len(part), self.triton_config.room) * self.triton_config.room
            columns = unit.new_empty(3, max(room, 1))
            columns[:, : len(part)] = unit.clamp(0, 1).T
            density = self._field.density_unit(columns, len(part))[: len(part)]
            parts.append(torch.where(inside, density / self.space.radius_m, 0.0))
        return torch.cat(parts).to(points.device)

    def state(self) -> dict[str, Tensor]:
        """Copies of all that changes, in main memory, as any other engine gives and reads them."""
        grid = self._field.grid
        return {
            **self._field.parameters.state(),
            "occupancy.opacity": grid.opacity.clone().cpu(),
            "occupancy.occupied": grid.occupied.clone().cpu(),
            "counters": torch.tensor([self._steps, grid.refreshes]),
            "generator": self._generator.get_state(),
        }

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` gave; see :class:`RadianceEngine`."""
        self.check_state(state)
        self._field.parameters.load(state)
        self._steps, refreshes = (int(x) for x in state["counters"])
        self._field.grid.restore(state["occupancy.opacity"], state["occupancy.occupied"], refreshes)
        self._generator.set_state(state["generator"])

    @torch.no_grad()
    def _train(self, batch: RayBatch, factor: float, gradients: RayGradients | None) -> StepReport:
        if batch.rays_a_pixel != 1:
            raise ValueError("the GPU engine learns one ray a pixel")
        check_finite_batch(batch)
        seed = self._new_seed()
        report = self._learn(batch, seed, gradients)
        self._apply(factor)
        if self._steps % self.optimiser_config.occupancy_every == 0:
            self._field.grid.refresh(self._field.density_unit, self._new_seed())
        return report

    def _learn(self, batch: RayBatch, seed: int, gradients: RayGradients | None) -> StepReport:
        """Leaves the gradient of the batch's loss with the parameters."""
        o, d = self._rays(batch.origins, batch.directions)
        colours, weights, backgrounds = batch.colours, batch.weights.to(self.device), None
        if self.optimiser_config.random_background:
            own = torch.full((3,), float(self.white_background))
            backgrounds, colours = random_background(
                *(colours.cpu(), None if batch.opacity is None else batch.opacity.cpu(), own), self._generator
            )
            backgrounds = backgrounds.to(self.device)
        colours = colours.to(self.device)
        trusted = weights > 0
        total_weight = torch.where(trusted, weights, 0.0).sum()
        sums, marched = torch.zeros(4, dtype=torch.float64, device=self.device), 0
        sums[2] = trusted.sum()
        for wave in self._field.waves(o, d, weights, seed, EXPLORING_SHARE, backgrounds):
            part = wave.part
            loss = ray_losses(wave.answers, colours[part], weights[part], total_weight, self.optimiser_config)
            to_rays = self._field.backward(wave, loss, learn=True, rays=gradients is not None)
            _copy_rays(to_rays, gradients, part)
            sums[0] += loss.loss.sum(dtype=torch.float64)
            sums[1] += loss.squared_error.sum(dtype=torch.float64)
            sums[3] += wave.reached.count[0]
            marched += wave.marched
        total, squared, rays, reached = sums.tolist()
        # of an unbounded ray only the samples worth learning from count, as in the native engine
        return StepReport(total, squared / max(rays, 1), int(reached) if self.space.unbounded else marched)

    def _apply(self, factor: float) -> None:
        """One step of Adam; clears the gradients."""
        p, rates, config = self._field.parameters, self.optimiser_config, self.triton_config
        self._steps += 1
        adam_step(
            *(p.table, p.table_moments, p.table_gradient, rates.table_learning_rate * factor, self._steps),
            *(rates, not config.update_untouched, self._field.encoding.level_weight),
        )
        rate = rates.network_learning_rate * factor
        adam_step(p.networks, p.network_moments, p.network_gradient, rate, self._steps, rates)

    def _new_seed(self) -> int:
        return int(torch.randint(2**62, (), generator=self._generator))

    def _rays(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        if origins.shape != directions.shape:
            raise ValueError(f"{len(origins)} origins do not go with {len(directions)} directions")
        check_finite_rays(origins, directions)
        return origins.to(self.device).contiguous(), directions.to(self.device).contiguous()


def _empty_rendering(origins: Tensor) -> Rendering:
    return Rendering(torch.empty_like(origins), *origins.new_empty(3, len(origins)).unbind(0))


def _copy_answers(answers, rendering: Rendering, part: slice) -> None:
    for name in ("colour", "depth_m", "opacity", "variance"):
        getattr(rendering, name)[part] = getattr(answers, name)


def _copy_rays(of_wave: RayGradients | None, gradients: RayGradients | None, part: slice) -> None:
    if of_wave is not None and gradients is not None:
        gradients.origins[part] = of_wave.origins
        gradients.directions[part] = of_wave.directions
