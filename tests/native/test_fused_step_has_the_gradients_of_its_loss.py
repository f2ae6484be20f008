"""The fused step against the same loss in double precision by autograd, at the same sample distances."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from mulan.geometry import se3
from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.native_buffers import address, native_field, native_scene
from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import (
    NativeGradients,
    NativeObjective,
    NativeParameters,
    NativeRendering,
    NativeStepReport,
)
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

    def reference_loss(
        self, table: Tensor, networks: Tensor, o: Tensor, d: Tensor, huber: float
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Loss with the variance head's likelihood, loss alone, rendered colours."""
        pixels = self.weights.double()[:: self.rays_a_pixel]
        share = pixels / pixels.sum()
        t, dt = self.t.double(), self.dt.double()
        on = torch.arange(t.shape[1]) < self.count[:, None]
        points = (o[:, None] + t[..., None] * d[:, None])[on]
        unit = reference.to_unit(points, self.space.radius_m, self.space.unbounded)
        along = d[:, None].expand(-1, t.shape[1], -1)[on]
        raw, colour, variance = reference.networks(
            networks, reference.encode(unit, table, FIELD), along, FIELD
        )
        empty = torch.zeros_like(t)
        depth = empty.masked_scatter(on, torch.exp(raw + reference.OFFSET) * dt[on] / self.space.radius_m)
        blend = reference.blend(depth, MARCH.min_transmittance)
        all_colours = empty[..., None].expand(-1, -1, 3).masked_scatter(on[..., None], colour)
        rendered = (blend[..., None] * all_colours).sum(1) + 1 - blend.sum(1)[:, None]
        seen = rendered.view(len(share), -1, 3).mean(1)
        error = seen - self.colours.double()[:: self.rays_a_pixel]
        size = error.abs()
        cost = error**2 if huber == 0 else torch.where(size <= huber, size**2, huber * (2 * size - huber))
        ray_variance = (blend.detach() ** 2 * empty.masked_scatter(on, variance)).sum(1)
        v = ray_variance.view(len(share), -1).mean(1) + 1e-4
        likelihood = 0.5 * ((error**2).mean(-1).detach() / v + v.log())
        plain = (share * cost.mean(-1)).sum()
        return plain + (share * likelihood).sum(), plain, rendered


def make_problem(library: NativeLibrary, unbounded: bool, rays_a_pixel: int = 1) -> Problem:
    g = torch.Generator().manual_seed(5)
    space = SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded)
    table, networks = random_table(g) * 2, random_networks(g, library)
    networks[FIELD.width * 2 * FIELD.levels :][: FIELD.width] *= 4  # rays of every opacity
    o, d = rays_towards(RAYS, 2.5 if not unbounded else 0.7, g)
    grid = pack(library, torch.rand(16, 16, 16, generator=g) < 0.6)
    d[20], d[30:33] = -d[20], -d[30:33]  # of a pixel, one ray or all rays that meet nothing (in a box)
    pixels = RAYS // rays_a_pixel
    weights = torch.rand(pixels, generator=g).repeat_interleave(rays_a_pixel)
    weights[:6] = 0.0
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


def native_answer(library: NativeLibrary, p: Problem, huber: float, threads: int = 2) -> Answer:
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
            NativeObjective(address(p.colours), address(p.weights), None, huber, 1.0, p.rays_a_pixel),
            NativeGradients(*(address(x) for x in gradients)),
            NativeRendering(*(address(x) for x in out)),
            report,
        )
    )
    c.mulan_workspace_destroy(workspace)
    return Answer(report, out[0], *gradients)


def relative(got: Tensor, want: Tensor) -> float:
    return float((got.double() - want).norm() / want.norm())


@pytest.mark.parametrize(("huber", "rays_a_pixel"), [(0.0, 1), (0.2, 1), (0.0, 3)])
@pytest.mark.parametrize("unbounded", [False, True], ids=["bounded", "unbounded"])
def test_all_gradients_match_autograd(
    build: NativeLibrary, unbounded: bool, huber: float, rays_a_pixel: int
) -> None:
    p = make_problem(build, unbounded, rays_a_pixel)
    leaves = [x.double().requires_grad_() for x in (p.table, p.networks, p.origins, p.directions)]
    total, plain, colours = p.reference_loss(leaves[0], leaves[1], leaves[2], leaves[3], huber)
    total.backward()
    got = native_answer(build, p, huber)
    assert got.report.loss == pytest.approx(float(plain.detach()), rel=1e-4)
    assert got.report.rays == RAYS - 6
    marched = int(p.count[6:].sum())
    # an unbounded ray's unreached samples are forgotten before they are counted
    assert 0 < got.report.kept < marched
    assert got.report.samples == (got.report.kept if unbounded else marched)
    used = p.weights > 0
    torch.testing.assert_close(got.colour[used], colours[used].float().detach(), rtol=1e-4, atol=1e-4)
    errors = [
        relative(mine, reference.gradient(leaf))
        for mine, leaf in zip((got.table, got.networks, got.origins, got.directions), leaves, strict=True)
    ]
    assert max(errors[:2]) < 1e-3
    # near a cell's wall single precision may take the neighbour's slope
    assert max(errors[2:]) < 2e-2


def test_the_variance_head_teaches_nothing_to_the_rest(library: NativeLibrary) -> None:
    p = make_problem(library, False)
    leaves = [x.double().requires_grad_() for x in (p.table, p.networks)]
    _, plain, _ = p.reference_loss(leaves[0], leaves[1], p.origins.double(), p.directions.double(), 0.0)
    plain.backward()
    got = native_answer(library, p, 0.0)
    head = FIELD.width + FIELD.geometry_features
    assert relative(got.table, reference.gradient(leaves[0])) < 1e-3
    assert relative(got.networks[:-head], reference.gradient(leaves[1])[:-head]) < 1e-3
    assert got.networks[-head:].abs().max() > 0


def test_pose_gradients_match_finite_differences_of_the_loss(library: NativeLibrary) -> None:
    """Two cameras moved by T exp(xi), samples' distances held."""
    p = make_problem(library, False)
    rng = np.random.default_rng(0)
    poses = se3.exp(rng.normal(size=(2, 6)))
    image = torch.arange(RAYS) % 2
    d_camera = np.stack([poses[i, :3, :3].T @ x for i, x in zip(image, p.directions.numpy(), strict=True)])
    o = p.origins.double().numpy()
    answer = native_answer(library, p, 0.0)
    R = torch.tensor(poses[:, :3, :3], dtype=torch.float32).contiguous()
    out = torch.zeros(2, 6)
    check(
        library.functions.mulan_pose_gradients(
            RAYS,
            address(p.directions),
            address(answer.origins),
            address(answer.directions),
            address(image),
            2,
            address(R),
            address(out),
        )
    )

    @torch.no_grad()
    def loss(xi: np.ndarray) -> float:
        delta = se3.exp(xi)
        R_moved = poses[:, :3, :3] @ delta[:, :3, :3]
        shift = (poses[:, :3, :3] @ delta[:, :3, 3, None])[..., 0]
        turned = np.stack([R_moved[i] @ d for i, d in zip(image, d_camera, strict=True)])
        moved = torch.tensor(o + shift[image.numpy()])
        return float(
            p.reference_loss(p.table.double(), p.networks.double(), moved, torch.tensor(turned), 0.0)[1]
        )

    step = 1e-6
    for camera in range(2):
        for axis in range(6):
            xi = np.zeros((2, 6))
            xi[camera, axis] = step
            slope = (loss(xi) - loss(-xi)) / (2 * step)
            assert float(out[camera, axis]) == pytest.approx(
                slope, rel=2e-2, abs=2e-2 * float(out.abs().max())
            )


def test_gradients_are_equal_bit_for_bit_at_any_number_of_threads(build: NativeLibrary) -> None:
    p = make_problem(build, False)
    one, three = native_answer(build, p, 0.0, threads=1), native_answer(build, p, 0.0, threads=3)
    assert one.report.loss == three.report.loss
    for name in ("colour", "table", "networks", "origins", "directions"):
        assert torch.equal(getattr(one, name), getattr(three, name))


def test_a_given_colour_gradient_takes_the_place_of_the_loss(library: NativeLibrary) -> None:
    p = make_problem(library, True)
    leaves = [x.double().requires_grad_() for x in (p.origins, p.directions)]
    _, _, colours = p.reference_loss(p.table.double(), p.networks.double(), leaves[0], leaves[1], 0.0)
    upstream = torch.randn(RAYS, 3, generator=torch.Generator().manual_seed(0))
    colours.backward(upstream.double())
    got = [torch.zeros(RAYS, 3), torch.zeros(RAYS, 3)]
    c = library.functions
    workspace = c.mulan_workspace_create(1)
    check(
        c.mulan_gradients(
            workspace,
            native_field(FIELD),
            native_scene(MARCH, p.space, True),
            p.grid.native,
            NativeParameters(address(p.table), address(p.networks)),
            native_rays(p.origins, p.directions),
            NativeObjective(colour_gradient=address(upstream), rays_a_pixel=1),
            NativeGradients(origins=address(got[0]), directions=address(got[1])),
            None,
            NativeStepReport(),
        )
    )
    c.mulan_workspace_destroy(workspace)
    assert relative(got[0], reference.gradient(leaves[0])) < 2e-2
    assert relative(got[1], reference.gradient(leaves[1])) < 2e-2
