import pytest
import torch

from mulan.radiance.gpu.composite_kernels import GpuCompositor
from mulan.radiance.gpu.ray_kernels import gather_ray_gradients, ray_losses
from mulan.radiance.gpu.reach_kernels import ReachedSamples
from mulan.radiance.gpu.space_kernels import SceneArguments
from mulan.radiance.kernels.composite import blend_weights, composite
from mulan.radiance.kernels.march import bounded_step_m, unbounded_step_m
from mulan.radiance.kernels.spherical_harmonics import spherical_harmonics
from mulan.radiance.torch_engine import RENDERED_VARIANCE_FLOOR
from tests.gpu.kernels.blocks import CONFIG
from tests.gpu.kernels.place import BOX, DEVICE, MARCH, WORLD, random, rays

RAYS, ROOM = 70, 4096
SPACES = pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])


def ragged() -> tuple[torch.Tensor, torch.Tensor]:
    """Offsets of rays with 0 to 60 samples, and the ray of each sample."""
    counts = torch.randint(61, (RAYS,), generator=torch.Generator().manual_seed(3))
    counts[5:8] = 0
    offsets = torch.zeros(RAYS + 1, dtype=torch.int32)
    offsets[1:] = counts.cumsum(0)
    return offsets.to(DEVICE), torch.arange(RAYS).repeat_interleave(counts)


@SPACES
def test_sums_and_their_gradients_are_the_references(space):
    offsets, ray = ragged()
    n = len(ray)
    distance, density = 1 + random(ROOM).abs(), random(ROOM, seed=1).exp()
    density[:3] = torch.tensor([1e-4, 3e3, 0.0])
    colour, variance = random(3, ROOM, seed=2).sigmoid(), random(ROOM, seed=3).exp()
    compositor = GpuCompositor(SceneArguments.of(MARCH, space, True), CONFIG)
    blend = torch.empty(ROOM, device=DEVICE)
    got = compositor.composite(offsets, distance, density, colour, variance, blend)

    t = distance[:n].cpu().double()
    step = unbounded_step_m(t, MARCH, space.radius_m) if space.unbounded else bounded_step_m(MARCH, space)
    log_density = density[:n].cpu().double().log().requires_grad_()
    logits = colour[:, :n].T.cpu().double().logit().requires_grad_()
    v = variance[:n].cpu().double().requires_grad_()
    weight = blend_weights(log_density.exp() * step / space.radius_m, ray)
    want = composite(weight, ray, logits.sigmoid(), v, t, RAYS)
    over_white = want.colour + (1 - want.opacity)[:, None]
    torch.testing.assert_close(blend[:n].cpu().double(), weight.detach(), rtol=1e-4, atol=1e-6)
    for mine, reference in (
        (got.colour, over_white),
        (got.opacity, want.opacity),
        (got.depth_m, want.distance_m),
        (got.variance, want.variance),
    ):
        torch.testing.assert_close(mine.cpu().double(), reference.detach(), rtol=1e-4, atol=1e-5)

    to_colour, to_variance = random(RAYS, 3, seed=4), random(RAYS, seed=5)
    out = compositor.backward(offsets, distance, density, colour, got, to_colour, to_variance)
    rendered = torch.zeros(RAYS).double().index_add(0, ray, weight.detach() ** 2 * v)
    ((over_white * to_colour.cpu()).sum() + (rendered * to_variance.cpu()).sum()).backward()
    torch.testing.assert_close(out.logits[:, :n].T.cpu().double(), logits.grad, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(out.variance[:n].cpu().double(), v.grad, rtol=1e-4, atol=1e-5)
    finite = log_density.grad.isfinite()  # the density of 0 has no logarithm
    torch.testing.assert_close(
        out.log_density[:n].cpu().double()[finite], log_density.grad[finite], rtol=1e-3, atol=1e-4
    )


@pytest.mark.parametrize("huber_delta", [None, 0.2])
def test_losses_and_their_gradients_are_autograds(huber_delta):
    answers = GpuCompositor(SceneArguments.of(MARCH, BOX, True), CONFIG).composite(
        torch.zeros(RAYS + 1, dtype=torch.int32, device=DEVICE),
        *(torch.zeros(x, device=DEVICE) for x in (ROOM, ROOM, (3, ROOM), ROOM)),
    )
    answers.colour.copy_(random(RAYS, 3).sigmoid())
    answers.variance.copy_(random(RAYS, seed=1).exp() * 0.1)
    target, weights = random(RAYS, 3, seed=2).sigmoid(), random(RAYS, seed=3).abs()
    weights[:4] = 0.0
    target[:4] = torch.nan
    total = weights.sum()
    got = ray_losses(answers, target, weights, total, huber_delta, CONFIG)

    used = weights.cpu() > 0
    colour, variance = (x.cpu().double().requires_grad_() for x in (answers.colour, answers.variance))
    error = (colour - target.cpu())[used]
    size = error.abs()
    cost = error.square()
    if huber_delta:
        cost = torch.where(size <= huber_delta, cost, huber_delta * (2 * size - huber_delta))
    share = (weights.cpu() / total.cpu())[used].double()
    squared = error.square().mean(-1)
    v = variance[used] + RENDERED_VARIANCE_FLOOR
    loss = (share * cost.mean(-1)).sum()
    (loss + (share * 0.5 * (squared.detach() / v + v.log())).sum()).backward()
    torch.testing.assert_close(got.loss.cpu().double().sum(), loss.detach(), rtol=1e-5, atol=0)
    torch.testing.assert_close(got.squared_error.cpu().double()[used], squared.detach(), rtol=1e-4, atol=1e-7)
    torch.testing.assert_close(got.colour_gradient.cpu().double(), colour.grad, rtol=1e-4, atol=1e-7)
    torch.testing.assert_close(got.variance_gradient.cpu().double(), variance.grad, rtol=1e-3, atol=1e-5)
    assert not got.loss[:4].any()


@SPACES
def test_gradients_gathered_along_rays_are_autograds(space):
    offsets, ray = ragged()
    n = len(ray)
    o, d = rays(RAYS)
    distance = 0.5 + random(ROOM).abs() * (3 if space.unbounded else 1)
    to_points, to_bands = random(3, ROOM, seed=1), random(16, ROOM, seed=2)
    nothing = torch.zeros(ROOM, device=DEVICE)
    index = nothing.int()
    samples = ReachedSamples(offsets, index, index, distance, nothing, torch.zeros(3, ROOM, device=DEVICE))
    scene = SceneArguments.of(MARCH, space, True)
    got = gather_ray_gradients(samples, o, d, to_points, to_bands, 3, scene, CONFIG)

    origins, directions = (x.cpu().double().requires_grad_() for x in (o, d))
    points = origins[ray] + distance[:n].cpu().double()[:, None] * directions[ray]
    bands = spherical_harmonics(directions, 3)[ray]
    total = (space.to_unit(points) * to_points[:, :n].T.cpu()).sum()
    (total + (bands * to_bands[:9, :n].T.cpu()).sum()).backward()
    torch.testing.assert_close(got.origins.cpu().double(), origins.grad, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(got.directions.cpu().double(), directions.grad, rtol=1e-4, atol=1e-3)
