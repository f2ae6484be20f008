import math

import torch

from mulan.radiance.config import MarchConfig
from mulan.radiance.kernels.march import march_rays, unbounded_distance_m
from mulan.radiance.space import SceneSpace

BOX = SceneSpace((1.0, 2.0, 3.0), 2.0, unbounded=False)
WORLD = SceneSpace((1.0, 2.0, 3.0), 2.0, unbounded=True)
MARCH = MarchConfig(steps=64, occupancy_resolution=8)
FULL = torch.ones(1, 8, 8, 8, dtype=torch.bool)


def random_rays(n=50, seed=0, reach_m=6.0):
    g = torch.Generator().manual_seed(seed)
    directions = torch.nn.functional.normalize(torch.randn(n, 3, generator=g), dim=-1)
    return torch.tensor([1.0, 2.0, 3.0]) + reach_m * torch.randn(n, 3, generator=g), directions


def test_samples_lie_in_the_box_in_order_and_their_steps_add_up_to_the_chord():
    origins, _ = random_rays()
    directions = torch.nn.functional.normalize(torch.tensor([1.0, 2.0, 3.0]) - origins, dim=-1)
    samples = march_rays(origins, directions, BOX, MARCH, FULL, torch.full((50,), 0.5))
    points = origins[samples.ray_index] + samples.distance_m[:, None] * directions[samples.ray_index]
    unit = BOX.to_unit(points)
    assert ((unit > -1e-5) & (unit < 1 + 1e-5)).all()
    assert (samples.ray_index.diff() >= 0).all()
    same = samples.ray_index.diff() == 0
    assert (samples.distance_m.diff()[same] > 0).all()
    chord = torch.zeros(50).index_add(0, samples.ray_index, samples.step_m)
    assert ((chord >= 2.0 * 0.95) & (chord <= 4 * math.sqrt(3) * 1.05)).all()


def test_rays_that_miss_the_box_get_no_sample():
    origins = torch.tensor([[1.0, 2.0, 9.0], [9.0, 9.0, 9.0]])
    directions = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    assert len(march_rays(origins, directions, BOX, MARCH, FULL, torch.zeros(2)).ray_index) == 0


def test_only_occupied_cells_are_sampled():
    occupied = torch.zeros(1, 8, 8, 8, dtype=torch.bool)
    occupied[0, 2, 5, 6] = True  # cascade, z, y, x
    low = torch.tensor([6.0, 5.0, 2.0]) / 8
    centre = BOX.to_world(low[None] + 1 / 16)
    origins, _ = random_rays()
    directions = torch.nn.functional.normalize(centre - origins, dim=-1)
    samples = march_rays(origins, directions, BOX, MARCH, occupied, torch.full((50,), 0.5))
    unit = BOX.to_unit(
        origins[samples.ray_index] + samples.distance_m[:, None] * directions[samples.ray_index]
    )
    assert len(unit) > 50
    assert ((unit > low - 1e-5) & (unit < low + 0.125 + 1e-5)).all()


def test_unbounded_steps_grow_and_cover_the_ray_from_near_to_far():
    origins, directions = random_rays(4)
    samples = march_rays(origins, directions, WORLD, MARCH, FULL, torch.full((4,), 0.5))
    step = samples.step_m.view(4, 64)
    assert (step.diff() > 0).all()
    edges = unbounded_distance_m(torch.tensor([0.0, 1.0]), 2.0)
    torch.testing.assert_close(step.sum(1), (edges[1] - edges[0]).expand(4), rtol=2e-3, atol=0.0)


def test_no_ray_gets_more_samples_than_the_bound():
    march = MarchConfig(steps=64, max_samples_per_ray=10)
    origins, directions = random_rays(reach_m=0.1)
    for space in (BOX, WORLD):
        samples = march_rays(origins, directions, space, march, FULL, torch.zeros(50))
        assert samples.ray_index.bincount().max() <= 10


def test_contraction_keeps_the_whole_world_in_the_unit_cube_and_the_inside_linear():
    g = torch.Generator().manual_seed(1)
    points = torch.randn(1000, 3, generator=g) * torch.logspace(-3, 6, 1000)[:, None]
    unit = WORLD.to_unit(points)
    assert (unit >= 0).all()
    assert (unit <= 1).all()
    inner = torch.tensor([[1.0, 2.0, 3.0], [3.0, 2.0, 1.0]])
    torch.testing.assert_close(WORLD.to_unit(inner), torch.tensor([[0.5, 0.5, 0.5], [0.75, 0.5, 0.25]]))


def test_to_world_undoes_to_unit():
    points = (
        torch.tensor([1.0, 2.0, 3.0]) + torch.randn(200, 3, generator=torch.Generator().manual_seed(2)) * 5
    )
    for space in (BOX, WORLD):
        torch.testing.assert_close(space.to_world(space.to_unit(points)), points, rtol=1e-3, atol=1e-3)
