from dataclasses import replace

import pytest
import torch

from mulan.radiance.gpu.march_kernels import Marcher
from mulan.radiance.gpu.random_kernels import EXPLORING, JITTER
from mulan.radiance.gpu.reach_kernels import keep_reached
from mulan.radiance.gpu.space_kernels import SceneArguments
from mulan.radiance.kernels.composite import transmittance
from mulan.radiance.kernels.march import march_rays
from tests.gpu.kernels.blocks import CONFIG
from tests.gpu.kernels.place import BOX, DEVICE, MARCH, WORLD, random, rays

SEED = 0xFEDCBA9876543210 >> 1
SPACES = pytest.mark.parametrize("space", [BOX, WORLD], ids=["bounded", "unbounded"])


def uniform(seed: int, index: int, dimension: int) -> float:
    """The native engine's random numbers (``native/src/random.h``) in plain integers."""

    def mix(x: int) -> int:
        x ^= x >> 16
        x = x * 0x7FEB352D & 0xFFFFFFFF
        x ^= x >> 15
        x = x * 0x846CA68B & 0xFFFFFFFF
        return x ^ x >> 16

    h = mix(index ^ mix(seed & 0xFFFFFFFF ^ mix(seed >> 32 ^ mix(dimension))))
    return (h >> 8) * 2.0**-24


def occupied_cells(cascades: int = 1) -> torch.Tensor:
    return random(cascades, 16, 16, 16, seed=5) > 0.3


def all_marched(
    marcher: Marcher, o: torch.Tensor, d: torch.Tensor, weights: torch.Tensor | None
) -> tuple[torch.Tensor, torch.Tensor]:
    parts = [
        (w.ray[: w.samples].cpu() + first, w.distance_m[: w.samples].cpu())
        for first, w in marcher.waves(o, d, weights)
    ]
    return torch.cat([p[0] for p in parts]), torch.cat([p[1] for p in parts])


@SPACES
@pytest.mark.parametrize("cascades", [1, 3])
def test_samples_are_the_references(space, cascades):
    o, d = rays(150)
    d[0] = torch.tensor([0.0, 0.0, 1.0])  # along an axis
    cells, scene = occupied_cells(cascades), SceneArguments.of(MARCH, space)
    jitter = torch.tensor([uniform(SEED, ray, JITTER) for ray in range(150)])
    want = march_rays(o.cpu(), d.cpu(), space, MARCH, cells.cpu(), jitter)
    ray, distance = all_marched(Marcher(cells, scene, CONFIG, SEED), o, d, None)
    assert torch.equal(ray.long(), want.ray_index)
    torch.testing.assert_close(distance, want.distance_m, rtol=1e-5, atol=1e-5)
    ((_, marched),) = Marcher(cells, scene, CONFIG, SEED).waves(o, d, None)
    points = o.cpu()[want.ray_index] + want.distance_m[:, None] * d.cpu()[want.ray_index]
    torch.testing.assert_close(
        marched.unit[:, : marched.samples].T.cpu(), space.to_unit(points), rtol=0, atol=1e-5
    )


def test_waves_march_the_same_samples_as_one_go():
    o, d = rays(150)
    cells, scene = occupied_cells(), SceneArguments.of(MARCH, BOX)
    whole = all_marched(Marcher(cells, scene, CONFIG, SEED), o, d, None)
    waves = replace(CONFIG, wave_rays=128, wave_samples=2000)
    parts = all_marched(Marcher(cells, scene, waves, SEED), o, d, None)
    assert torch.equal(whole[0], parts[0])
    assert torch.equal(whole[1], parts[1])


def test_rays_of_no_weight_have_no_samples():
    o, d = rays(100)
    weights = (torch.arange(100, device=DEVICE) % 2).float()
    scene = SceneArguments.of(MARCH, BOX)
    ray, _ = all_marched(Marcher(occupied_cells(), scene, CONFIG, None), o, d, weights)
    assert len(ray) > 0
    assert (ray % 2 == 1).all()


@SPACES
@pytest.mark.parametrize("least_opacity", [0.0, 0.05])
def test_kept_samples_are_those_that_light_reaches_and_that_are_not_thin(space, least_opacity):
    o, d = rays(100)
    scene = SceneArguments.of(MARCH, space)
    ((_, marched),) = Marcher(occupied_cells(), scene, CONFIG, None).waves(o, d, None)
    n = marched.samples
    density = (2 * random(len(marched.ray), seed=3)).exp()
    reached = keep_reached(marched, density, scene, CONFIG, least_opacity, 0.3, SEED)
    ray = marched.ray[:n].cpu().long()
    reference = march_rays(o.cpu(), d.cpu(), space, MARCH, occupied_cells().cpu(), torch.full((100,), 0.5))
    depth = density[:n].cpu() * reference.step_m / space.radius_m
    explores = torch.tensor([uniform(SEED, i, EXPLORING) < 0.3 for i in range(100)])
    thick = explores[ray] | (-torch.expm1(-depth) >= least_opacity)
    light = transmittance(depth.where(thick, 0.0), ray)
    assert ((light - MARCH.min_transmittance).abs() > 1e-6).all()  # no sample is on the brink
    kept = (thick & (light > MARCH.min_transmittance)).nonzero()[:, 0]
    assert int(reached.count) == len(kept)
    assert 0 < len(kept) < n
    source = reached.source[: len(kept)].long()
    assert torch.equal(source.cpu(), kept)
    for name in ("ray", "distance_m"):
        assert torch.equal(getattr(reached, name)[: len(kept)], getattr(marched, name)[source])
    assert torch.equal(reached.density[: len(kept)], density[source])
    assert torch.equal(reached.unit[:, : len(kept)], marched.unit[:, source])
    counts = torch.bincount(ray[kept], minlength=100)
    assert torch.equal(reached.offsets[1:].cpu().long(), counts.cumsum(0))
