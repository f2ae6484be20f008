import pytest
import torch

from mulan.radiance.gpu.composite_backward_kernel import composite_backward
from mulan.radiance.gpu.composite_kernels import GpuCompositor, RayAnswers
from mulan.radiance.gpu.ray_kernels import gather_ray_gradients
from mulan.radiance.gpu.ray_losses import RayLosses, ray_losses
from mulan.radiance.gpu.reach_kernels import ReachedSamples
from mulan.radiance.gpu.space_kernels import SceneArguments
from mulan.radiance.kernels.composite import blend_weights, composite
from mulan.radiance.kernels.distortion import distortion
from mulan.radiance.kernels.march import bounded_step_m, fraction_of_ray, step_count, unbounded_step_m
from mulan.radiance.kernels.spherical_harmonics import spherical_harmonics
from mulan.radiance.loss import RENDERED_VARIANCE_FLOOR, GaussianLikelihoodLoss, HuberLoss
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace
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


def packed_distances(offsets: torch.Tensor, space: SceneSpace) -> torch.Tensor:
    """Distances that grow along each ray."""
    out = torch.zeros(ROOM, device=DEVICE)
    for first, end in zip(offsets[:-1].tolist(), offsets[1:].tolist(), strict=True):
        reach = 20.0 if space.unbounded else 2.0
        out[first:end] = 0.3 + reach * (random(end - first, seed=first).sigmoid().sort().values)
    return out


@SPACES
@pytest.mark.parametrize("everything", [False, True], ids=["plain", "distortion and a variance that teaches"])
def test_sums_and_their_gradients_are_the_references(space, everything):
    offsets, ray = ragged()
    n = len(ray)
    distance, density = packed_distances(offsets, space), random(ROOM, seed=1).exp()
    density[:2] = torch.tensor([1e-4, 3e3])
    colour, variance = random(3, ROOM, seed=2).sigmoid(), random(ROOM, seed=3).exp()
    background = random(RAYS, 3, seed=6).sigmoid() if everything else torch.ones(3, device=DEVICE)
    scene = SceneArguments.of(MARCH, space)
    blend = torch.empty(ROOM, device=DEVICE)
    samples = offsets, distance, density, colour, variance
    got = GpuCompositor(scene, CONFIG).composite(*samples, background, blend)

    t = distance[:n].cpu().double()
    step = unbounded_step_m(t, MARCH, space.radius_m) if space.unbounded else bounded_step_m(MARCH, space)
    log_density = density[:n].cpu().double().log().requires_grad_()
    logits = colour[:, :n].T.cpu().double().logit().requires_grad_()
    v = variance[:n].cpu().double().requires_grad_()
    weight = blend_weights(log_density.exp() * step / space.radius_m, ray)
    want = composite(weight, ray, logits.sigmoid(), v, t, RAYS)
    over = want.colour + (1 - want.opacity)[:, None] * background.cpu()
    torch.testing.assert_close(blend[:n].cpu().double(), weight.detach(), rtol=1e-4, atol=1e-6)
    for mine, reference in (
        (got.colour, over),
        (got.opacity, want.opacity),
        (got.depth_m, want.distance_m),
        (got.variance, want.variance),
    ):
        torch.testing.assert_close(mine.cpu().double(), reference.detach(), rtol=1e-4, atol=1e-5)

    to_colour, to_opacity, to_variance = random(RAYS, 3, seed=4), random(RAYS, seed=5), random(RAYS, seed=7)
    scattering = random(RAYS, seed=8).abs()
    losses = RayLosses(
        *(torch.zeros(RAYS, device=DEVICE), scattering, to_colour, to_opacity, to_variance),
        scattering if everything else None,
        everything,
    )
    out = composite_backward(*samples, background, losses, scene, CONFIG)
    rendered = want.variance
    if not everything:
        rendered = torch.zeros(RAYS).double().index_add(0, ray, weight.detach() ** 2 * v)
    objective = (over * to_colour.cpu()).sum() + (want.opacity * to_opacity.cpu()).sum()
    objective = objective + (rendered * to_variance.cpu()).sum()
    if everything:
        place = fraction_of_ray(t, MARCH, space)
        spread = scattering.cpu() * distortion(weight, ray, place, 1 / step_count(MARCH), RAYS)
        torch.testing.assert_close(losses.loss.cpu().double(), spread.detach(), rtol=1e-3, atol=1e-6)
        objective = objective + spread.sum()
    objective.backward()
    torch.testing.assert_close(out.logits[:, :n].T.cpu().double(), logits.grad, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(out.variance[:n].cpu().double(), v.grad, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(out.log_density[:n].cpu().double(), log_density.grad, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    "optimiser",
    [
        OptimiserConfig(),
        OptimiserConfig(loss=HuberLoss(0.2), entropy_weight=0.3),
        OptimiserConfig(loss=GaussianLikelihoodLoss(), distortion_weight=0.1),
    ],
    ids=["squared", "huber and entropy", "likelihood"],
)
def test_gradients_of_losses_are_finite_differences(optimiser):
    colour, opacity, variance = (
        random(RAYS, 3).sigmoid(),
        random(RAYS, seed=1).sigmoid(),
        random(RAYS, seed=2).exp(),
    )
    target, weights = random(RAYS, 3, seed=3).sigmoid().double(), random(RAYS, seed=4).abs().double()
    weights[:4], target[:4] = 0.0, torch.nan
    collected = [x.double() for x in (colour, opacity, variance)]

    def total(colour: torch.Tensor, opacity: torch.Tensor, variance: torch.Tensor) -> RayLosses:
        answers = RayAnswers(colour, opacity, opacity, variance)
        return ray_losses(answers, target, weights, weights.sum(), optimiser)

    got = total(*collected)
    assert not got.loss[:4].any()
    assert not got.colour_gradient[:4].any()
    squared = (collected[0] - target)[4:].square().mean(-1)
    torch.testing.assert_close(got.squared_error[4:], squared)
    assert (got.distortion_weight is None) == (optimiser.distortion_weight == 0)
    share = weights / weights.sum()
    nudge = 1e-6
    for position, gradient in ((0, got.colour_gradient[:, 1]), (1, got.opacity_gradient)):
        sides = []
        for sign in (1, -1):
            moved = [x.clone() for x in collected]
            (moved[0][:, 1] if position == 0 else moved[1]).add_(sign * nudge)
            sides.append(total(*moved).loss)
        torch.testing.assert_close(gradient, (sides[0] - sides[1]) / (2 * nudge), rtol=1e-4, atol=1e-8)
    v = collected[2] + RENDERED_VARIANCE_FLOOR
    likelihood = torch.where(weights > 0, share * 0.5 * (1 / v - got.squared_error / v**2), 0.0)
    torch.testing.assert_close(got.variance_gradient, likelihood)


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
    scene = SceneArguments.of(MARCH, space)
    got = gather_ray_gradients(samples, o, d, to_points, to_bands, 3, scene, CONFIG)

    origins, directions = (x.cpu().double().requires_grad_() for x in (o, d))
    points = origins[ray] + distance[:n].cpu().double()[:, None] * directions[ray]
    bands = spherical_harmonics(directions, 3)[ray]
    total = (space.to_unit(points) * to_points[:, :n].T.cpu()).sum()
    (total + (bands * to_bands[:9, :n].T.cpu()).sum()).backward()
    torch.testing.assert_close(got.origins.cpu().double(), origins.grad, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(got.directions.cpu().double(), directions.grad, rtol=1e-4, atol=1e-3)
