"""A batch of rays, its loss in double precision by autograd, and the fused step's answer to it."""

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.march import FAR_RADII, NEAR_RADII
from mulan.radiance.kernels.native_buffers import address, native_field, native_scene
from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_objective import huber_delta
from mulan.radiance.kernels.native_structures import (
    NativeGradients,
    NativeObjective,
    NativeParameters,
    NativeRendering,
    NativeStepReport,
)
from mulan.radiance.loss import ColourLoss, GaussianLikelihoodLoss, HuberLoss, SquaredLoss
from mulan.radiance.space import SceneSpace
from tests.native import reference
from tests.native.fields import (
    FIELD,
    Grid,
    march,
    native_rays,
    pack,
    random_networks,
    random_table,
    rays_towards,
)

RAYS = 60
MARCH = MarchConfig(steps=48, occupancy_resolution=16, min_transmittance=1e-2)


@dataclass(frozen=True)
class Costs:
    """What is counted."""

    loss: ColourLoss = field(default_factory=SquaredLoss)
    distortion: float = 0.0
    entropy: float = 0.0
    backgrounds: Tensor | None = None


@dataclass
class Problem:
    space: SceneSpace
    table: Tensor
    networks: Tensor
    origins: Tensor
    directions: Tensor
    colours: Tensor
    weights: Tensor
    grid: Grid
    count: Tensor
    t: Tensor
    dt: Tensor
    rays_a_pixel: int = 1

    def over_pixel(self, of_rays: Tensor) -> Tensor:
        return of_rays.view(-1, self.rays_a_pixel, *of_rays.shape[1:]).mean(1)

    def reference_loss(
        self, table: Tensor, networks: Tensor, o: Tensor, d: Tensor, costs: Costs
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What is minimised, the reported loss (without the variance head's own), rendered colours."""
        share = self.over_pixel(self.weights.double())
        share = share / share.sum()
        t, dt = self.t.double(), self.dt.double()
        on = torch.arange(t.shape[1]) < self.count[:, None]
        points = (o[:, None] + t[..., None] * d[:, None])[on]
        unit = reference.to_unit(points, self.space.radius_m, self.space.unbounded)
        along = d[:, None].expand(-1, t.shape[1], -1)[on]
        teaches = isinstance(costs.loss, GaussianLikelihoodLoss)
        raw, colour, variance = reference.networks(
            networks, reference.encode(unit, table, FIELD), along, FIELD, teaches
        )
        empty = torch.zeros_like(t)
        depth = empty.masked_scatter(on, torch.exp(raw + reference.OFFSET) * dt[on] / self.space.radius_m)
        blend = reference.blend(depth, MARCH.min_transmittance)
        opacity = blend.sum(1)
        all_colours = empty[..., None].expand(-1, -1, 3).masked_scatter(on[..., None], colour)
        behind = torch.ones(3) if costs.backgrounds is None else costs.backgrounds
        rendered = (blend[..., None] * all_colours).sum(1) + (1 - opacity)[:, None] * behind.double()
        error = self.over_pixel(rendered - self.colours.double())
        in_head = blend if teaches else blend.detach()
        v = self.over_pixel((in_head**2 * empty.masked_scatter(on, variance)).sum(1)) + 1e-4
        likelihood = 0.5 * ((error**2).mean(-1) / v + v.log())
        head = 0.5 * ((error**2).mean(-1).detach() / v + v.log())
        if teaches:
            cost, head = likelihood, torch.zeros_like(head)
        elif isinstance(costs.loss, HuberLoss):
            size, corner = error.abs(), costs.loss.delta
            cost = torch.where(size <= corner, size**2, corner * (2 * size - corner)).mean(-1)
        else:
            cost = (error**2).mean(-1)
        if costs.distortion:
            cost = cost + costs.distortion * self.over_pixel(self._distortion(t, blend))
        if costs.entropy:
            p = opacity.clamp(1e-3, 1 - 1e-3)
            cost = cost - costs.entropy * self.over_pixel(p * p.log() + (1 - p) * (1 - p).log())
        plain = (share * cost).sum()
        return plain + (share * head).sum(), plain, rendered

    def _distortion(self, t: Tensor, blend: Tensor) -> Tensor:
        """All pairs of samples, as the equation is written."""
        if self.space.unbounded:
            s = torch.asinh(t / self.space.radius_m - NEAR_RADII) / math.asinh(FAR_RADII - NEAR_RADII)
        else:
            s = t / (2 * math.sqrt(3) * self.space.radius_m)
        pairs = blend[:, :, None] * blend[:, None, :] * (s[:, :, None] - s[:, None, :]).abs()
        return pairs.sum((1, 2)) + (blend**2).sum(1) / (3 * MARCH.steps)


def make_problem(library: NativeLibrary, unbounded: bool, rays_a_pixel: int = 1) -> Problem:
    g = torch.Generator().manual_seed(9)  # no sample within rounding of the transmittance cut
    space = SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded)
    table, networks = random_table(g) * 2, random_networks(g, library)
    networks[FIELD.width * 2 * FIELD.levels :][: FIELD.width] *= 4  # rays of every opacity
    o, d = rays_towards(RAYS, 2.5 if not unbounded else 0.7, g)
    grid = pack(library, torch.rand(16, 16, 16, generator=g) < 0.6)
    d[20], d[30:33] = -d[20], -d[30:33]  # of a pixel, one ray or all rays that meet nothing (in a box)
    pixels = RAYS // rays_a_pixel
    weights = torch.rand(pixels, generator=g).repeat_interleave(rays_a_pixel)
    weights[: 2 * 3] = 0.0
    colours = torch.rand(pixels, 3, generator=g).repeat_interleave(rays_a_pixel, 0)
    count, t, dt = march(library, MARCH, space, grid, o, d)
    return Problem(space, table, networks, o, d, colours, weights, grid, count, t, dt, rays_a_pixel)


@dataclass
class Answer:
    report: NativeStepReport
    colour: Tensor
    table: Tensor
    networks: Tensor
    origins: Tensor
    directions: Tensor


def native_answer(library: NativeLibrary, p: Problem, costs: Costs, threads: int = 2) -> Answer:
    c = library.functions
    workspace = c.mulan_workspace_create(threads)
    out = [torch.zeros(RAYS, 3), *torch.zeros(3, RAYS).unbind(0)]
    gradients = [torch.zeros_like(x) for x in (p.table, p.networks, p.origins, p.directions)]
    report = NativeStepReport()
    check(
        c.mulan_gradients(
            workspace,
            native_field(FIELD),
            native_scene(MARCH, p.space, True),
            p.grid.native,
            NativeParameters(address(p.table), address(p.networks)),
            native_rays(p.origins, p.directions),
            NativeObjective(
                colours=address(p.colours),
                weights=address(p.weights),
                backgrounds=None if costs.backgrounds is None else address(costs.backgrounds),
                huber_delta=huber_delta(costs.loss),
                variance_weight=1.0,
                likelihood=costs.loss.teaches_variance,
                distortion_weight=costs.distortion,
                entropy_weight=costs.entropy,
                rays_a_pixel=p.rays_a_pixel,
            ),
            NativeGradients(*(address(x) for x in gradients)),
            NativeRendering(*(address(x) for x in out)),
            report,
        )
    )
    c.mulan_workspace_destroy(workspace)
    return Answer(report, out[0], *gradients)
