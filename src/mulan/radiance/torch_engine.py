"""The radiance field in plain torch: the readable reference and the fallback on any machine."""

import torch
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.background import random_background
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch, RaySamples, Rendering, StepReport
from mulan.radiance.finite import check_finite, check_finite_batch, check_finite_rays
from mulan.radiance.kernels.composite import Composite
from mulan.radiance.kernels.distortion import distortion
from mulan.radiance.kernels.march import fraction_of_ray, step_count
from mulan.radiance.loss import (
    RENDERED_VARIANCE_FLOOR,
    gaussian_likelihood,
    opacity_entropy,
)
from mulan.radiance.networks import RadianceField
from mulan.radiance.occupancy import OccupancyGrid
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.ray_gradients import RayGradients
from mulan.radiance.rendering import FieldSamples, evaluate_rays
from mulan.radiance.space import SceneSpace
from mulan.radiance.split_step import BatchPart, ParameterGradients, SplitStepEngine

EXPLORING_SHARE = 0.1  # rays that learn from thin samples too, or nothing could ever grow out of empty space


class TorchEngine(SplitStepEngine):
    """Reference implementation of :class:`RadianceEngine` on the CPU.

    Two engines with the same arguments and the same batches are equal bit for bit (at one thread count).
    """

    def __init__(
        self,
        field: FieldConfig,
        march: MarchConfig,
        space: SceneSpace,
        white_background: bool,
        seed: int = 0,
        optimiser: OptimiserConfig | None = None,
    ) -> None:
        """An untrained field.

        Args:
            field: Sizes.
            march: Sampling.
            space: Where the field lives.
            white_background: What rays that hit nothing see: white, or black.
            seed: Of the initial parameters and of the sampling.
            optimiser: Learning rates and loss.
        """
        self.march_config, self.space, self.white_background = march, space, white_background
        self.optimiser_config = optimiser or OptimiserConfig()
        self._generator = torch.Generator().manual_seed(seed)
        self.field = RadianceField(field, self._generator)
        self._occupancy = OccupancyGrid(march, space)
        self._background = torch.full((3,), float(white_background))
        self._steps = 0
        networks = [p for name, p in self.field.named_parameters() if name != "table"]
        self._adam = torch.optim.Adam(
            [{"params": [self.field.table]}, {"params": networks}],
            betas=(self.optimiser_config.beta1, self.optimiser_config.beta2),
            eps=self.optimiser_config.epsilon,
            fused=True,
        )

    @property
    def field_config(self) -> FieldConfig:
        """Sizes of the field."""
        return self.field.config

    def train_step(self, batch: RayBatch, learning_rate_factor: float) -> StepReport:
        """One optimiser step; see :class:`RadianceEngine`."""
        report = self._backward(batch, batch.origins, batch.directions)
        self._step(learning_rate_factor)
        return report

    @property
    def parameter_count(self) -> int:
        """See :class:`SplitStepEngine`; the order is that of ``field.parameters()``."""
        return sum(parameter.numel() for parameter in self.field.parameters())

    def gradients(
        self, batch: RayBatch, part: BatchPart | None = None, out: Float[Tensor, "parameters"] | None = None
    ) -> tuple[ParameterGradients, StepReport]:
        """First half of a step; see :class:`SplitStepEngine`."""
        report = self._backward(batch, batch.origins, batch.directions, part)
        flat = [
            (torch.zeros_like(p) if p.grad is None else p.grad).flatten() for p in self.field.parameters()
        ]
        values = torch.cat(flat, out=out)
        used = batch.weights[batch.weights > 0]
        return ParameterGradients(values, float(used.sum()), len(used)), report

    def apply(self, gradients: ParameterGradients, learning_rate_factor: float) -> None:
        """Second half of a step; see :class:`SplitStepEngine`."""
        parameters = list(self.field.parameters())
        parts = gradients.values.split([parameter.numel() for parameter in parameters])
        for parameter, gradient in zip(parameters, parts, strict=True):
            parameter.grad = gradient.view_as(parameter).clone()
        self._step(learning_rate_factor)

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
        """
        perturbation = R_world_camera.new_zeros(len(R_world_camera), 6).requires_grad_()
        turn, shift = (R_world_camera @ perturbation.view(-1, 2, 3, 1)[:, i] for i in (0, 1))
        origins = batch.origins + shift[batch.image_index, :, 0]
        turned = torch.cross(turn[batch.image_index, :, 0], batch.directions, dim=-1)
        report = self._backward(batch, origins, batch.directions + turned)
        self._step(learning_rate_factor)
        gradient = perturbation.grad
        return report, torch.zeros_like(perturbation) if gradient is None else gradient

    def _backward(
        self,
        batch: RayBatch,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        part: BatchPart | None = None,
    ) -> StepReport:
        check_finite_batch(batch)
        part = part or BatchPart.whole(len(batch.weights))
        config = self.optimiser_config
        a_pixel = batch.rays_a_pixel
        pixels = (batch.weights[::a_pixel] > 0).nonzero()[:, 0]
        used = (pixels[:, None] * a_pixel + torch.arange(a_pixel)).flatten()
        origins, directions = origins[used], directions[used]
        weights = batch.weights[::a_pixel][pixels]
        background, target = self._background, batch.colours[::a_pixel]
        if config.random_background:
            opacity = None if batch.opacity is None else batch.opacity[::a_pixel]
            of_pixels = part.in_pixels(a_pixel)
            background, target = random_background(target, opacity, background, self._generator, of_pixels)
            background = background[pixels]
        target = target[pixels]
        jitter = part.uniform(self._generator)[used]
        least = self._least_opacity(len(batch.weights))
        if least is not None:
            least[part.uniform(self._generator) < EXPLORING_SHARE] = 0.0
            least = least[used]
        samples = self._evaluate(origins, directions, jitter, least, config.loss.teaches_variance)
        rendered = samples.composite(len(used))
        seen = over_pixel(rendered.colour, a_pixel)
        error = seen + (1 - over_pixel(rendered.opacity, a_pixel))[:, None] * background - target
        squared = error.square().mean(-1)
        share = weights / weights.sum().clamp_min(1e-12)
        loss = (share * self._cost(samples, rendered, error, a_pixel)).sum()
        objective = loss
        if not config.loss.teaches_variance:
            # blend and residual are detached so that this likelihood trains the head only
            variance = over_pixel(_rendered_variance(samples, len(used)), a_pixel) + RENDERED_VARIANCE_FLOOR
            objective = loss + (share * gaussian_likelihood(squared.detach(), variance)).sum()
        self._adam.zero_grad(set_to_none=True)
        objective.backward()
        mean_squared = float(squared.detach().mean()) if len(used) else 0.0
        return StepReport(loss=float(loss.detach()), mean_squared_error=mean_squared, samples=samples.marched)

    def _step(self, factor: float) -> None:
        config = self.optimiser_config
        rates = (config.table_learning_rate, config.network_learning_rate)
        for group, rate in zip(self._adam.param_groups, rates, strict=True):
            group["lr"] = rate * factor
        self._adam.step()
        self._steps += 1
        if self._steps % config.occupancy_every == 0:
            self._refresh_occupancy()

    @torch.no_grad()
    def render(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> Rendering:
        """Colour, depth, opacity and colour variance along rays; see :class:`RadianceEngine`.

        The depth is the blend's mean distance, 0 where nothing is hit.
        """
        check_finite_rays(origins, directions)
        parts = []
        for start in range(0, len(origins), self._rays_at_once):
            o = origins[start : start + self._rays_at_once]
            samples = self._evaluate(
                o, directions[start : start + len(o)], torch.full((len(o),), 0.5), self._least_opacity(len(o))
            )
            c = samples.composite(len(o))
            colour = c.colour + (1 - c.opacity)[:, None] * self._background
            parts.append((colour, c.distance_m, c.opacity, c.variance))
        if not parts:
            empty = origins.new_zeros(0)
            return Rendering(origins.new_zeros(0, 3), empty, empty, empty)
        colour, distance, opacity, variance = (torch.cat(column) for column in zip(*parts, strict=True))
        return Rendering(colour.clamp(0, 1), distance, opacity, variance)

    def set_level_weights(self, weights: Float[Tensor, "levels"]) -> None:
        """See :class:`RadianceEngine`."""
        if len(weights) != self.field.config.levels or not bool(torch.isfinite(weights).all()):
            raise ValueError(f"{self.field.config.levels} finite weights are needed")
        self.field.level_weights = weights.clone()

    def ray_gradients(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        colour_gradient: Float[Tensor, "r 3"],
    ) -> tuple[Rendering, RayGradients]:
        """See :class:`RadianceEngine`."""
        check_finite_rays(origins, directions)
        check_finite("colour gradients", colour_gradient)
        parts, gradients = [], []
        for some in torch.arange(len(origins)).split(self._rays_at_once):
            o, d = (x[some].detach().clone().requires_grad_() for x in (origins, directions))
            middle, least = torch.full((len(some),), 0.5), self._least_opacity(len(some))
            c = self._evaluate(o, d, middle, least).composite(len(some))
            colour = c.colour + (1 - c.opacity)[:, None] * self._background
            wanted = (colour * colour_gradient[some]).sum()
            gradients.append(
                torch.autograd.grad(wanted, (o, d), materialize_grads=True)
                if wanted.requires_grad
                else (torch.zeros_like(o), torch.zeros_like(d))
            )
            shown = colour.clamp(0, 1), c.distance_m, c.opacity, c.variance
            parts.append([x.detach() for x in shown])
        if not parts:
            return self.render(origins, directions), RayGradients(origins.clone(), directions.clone())
        rendering = Rendering(*(torch.cat(column) for column in zip(*parts, strict=True)))
        return rendering, RayGradients(*(torch.cat(column) for column in zip(*gradients, strict=True)))

    def parameter_gradient(
        self,
        origins: Float[Tensor, "r 3"],
        directions: Float[Tensor, "r 3"],
        colour_gradient: Float[Tensor, "r 3"],
    ) -> Float[Tensor, "parameters"]:
        """See :class:`SplitStepEngine`."""
        check_finite_rays(origins, directions)
        check_finite("colour gradients", colour_gradient)
        parameters = list(self.field.parameters())
        values = torch.zeros(self.parameter_count)
        for some in torch.arange(len(origins)).split(self._rays_at_once):
            middle, least = torch.full((len(some),), 0.5), self._least_opacity(len(some))
            c = self._evaluate(origins[some], directions[some], middle, least).composite(len(some))
            colour = c.colour + (1 - c.opacity)[:, None] * self._background
            wanted = (colour * colour_gradient[some]).sum()
            if wanted.requires_grad:
                parts = torch.autograd.grad(wanted, parameters, allow_unused=True, materialize_grads=True)
                values += torch.cat([part.flatten() for part in parts])
        return values

    @torch.no_grad()
    def sample(self, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]) -> RaySamples:
        """The samples a rendering is made of; see :class:`RadianceEngine`."""
        check_finite_rays(origins, directions)
        parts = []
        for start in range(0, max(len(origins), 1), self._rays_at_once):
            o = origins[start : start + self._rays_at_once]
            s = self._evaluate(
                o, directions[start : start + len(o)], torch.full((len(o),), 0.5), self._least_opacity(len(o))
            )
            parts.append((s.ray_index + start, s.blend, s.colour, s.variance, s.distance_m))
        return RaySamples(*(torch.cat(column) for column in zip(*parts, strict=True)))

    @torch.no_grad()
    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        """Density [1/m] at world points, 0 outside a bounded scene."""
        unit = self.space.to_unit(points)
        inside = ((unit >= 0) & (unit <= 1)).all(-1)
        return torch.where(inside, self._density_unit(unit.clamp(0, 1)), 0.0)

    def state(self) -> dict[str, Tensor]:
        """Parameters, Adam moments, occupancy, counters and generator, as copies."""
        state = {}
        for name, parameter in self.field.named_parameters():
            state[name] = parameter.detach().clone()
            moments = self._adam.state.get(parameter, {})
            for key in ("exp_avg", "exp_avg_sq"):
                state[f"{key}.{name}"] = moments.get(key, torch.zeros_like(parameter)).detach().clone()
        state["occupancy.opacity"] = self._occupancy.opacity.clone()
        state["occupancy.occupied"] = self._occupancy.occupied.clone()
        state["counters"] = torch.tensor([self._steps, self._occupancy.refreshes])
        state["generator"] = self._generator.get_state()
        return state

    def load_state(self, state: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` gave; see :class:`RadianceEngine`."""
        self.check_state(state)
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
        self._generator.set_state(state["generator"])

    @property
    def _rays_at_once(self) -> int:
        # memory stays bounded whatever the occupancy
        return max(1, 2**20 // self.march_config.steps)

    def _least_opacity(self, rays: int) -> Tensor | None:
        """Opacity below which samples of each ray count as empty, where there is such a bound."""
        if self.space.unbounded and self._occupancy.is_warm:
            return torch.full((rays,), self.march_config.least_opacity)
        return None

    def _evaluate(
        self,
        origins: Tensor,
        directions: Tensor,
        jitter: Tensor,
        least: Tensor | None,
        teaches_variance: bool = False,
    ) -> FieldSamples:
        march, occupied = self.march_config, self._occupancy.occupied
        return evaluate_rays(
            self.field, self.space, march, occupied, origins, directions, jitter, least, teaches_variance
        )

    def _cost(
        self, samples: FieldSamples, rendered: Composite, error: Float[Tensor, "p 3"], rays_a_pixel: int
    ) -> Float[Tensor, "p"]:
        config = self.optimiser_config
        cost = config.loss(error, over_pixel(rendered.variance, rays_a_pixel) + RENDERED_VARIANCE_FLOOR)
        if config.distortion_weight > 0:
            march = self.march_config
            place = fraction_of_ray(samples.distance_m, march, self.space)
            scatter = distortion(
                samples.blend, samples.ray_index, place, 1 / step_count(march), len(rendered.opacity)
            )
            cost = cost + config.distortion_weight * over_pixel(scatter, rays_a_pixel)
        if config.entropy_weight > 0:
            cost = cost + config.entropy_weight * over_pixel(opacity_entropy(rendered.opacity), rays_a_pixel)
        return cost

    def _density_unit(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n"]:
        parts = [self.field.geometry(chunk)[0] for chunk in unit.split(2**17)]
        return torch.cat(parts) / self.space.radius_m

    @torch.no_grad()
    def _refresh_occupancy(self) -> None:
        cells = self._occupancy.choose_cells(self._generator)
        unit = self._occupancy.points_in(cells, self._generator)
        self._occupancy.refresh(cells, unit, self._density_unit(unit))


def over_pixel(of_rays: Float[Tensor, "r *k"], rays_a_pixel: int) -> Float[Tensor, "p *k"]:
    """Mean over each pixel's neighbouring rays."""
    return of_rays.view(-1, rays_a_pixel, *of_rays.shape[1:]).mean(1)


def _rendered_variance(samples: FieldSamples, rays: int) -> Float[Tensor, "r"]:
    blend = samples.blend.detach()
    zero = torch.zeros(rays, dtype=blend.dtype)
    return zero.index_add(0, samples.ray_index, blend.square() * samples.variance)
