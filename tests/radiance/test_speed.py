import math

import torch

from mulan.radiance.speed import measure_training_speed, sphere_batch


def test_a_measurement_takes_about_as_long_as_asked_and_finds_a_rate():
    speed = measure_training_speed(0.05)
    assert math.isfinite(speed.samples_per_s)
    assert speed.samples_per_s > speed.rays_per_s > 0


def test_the_scene_is_a_sphere_before_white():
    batch = sphere_batch(2000, torch.Generator().manual_seed(0))
    hit = (batch.colours < 1).any(-1)
    closest = torch.linalg.cross(batch.origins, batch.directions).norm(dim=-1)
    assert torch.equal(hit, closest < 0.5)
    assert 0 <= batch.colours.min() <= batch.colours.max() <= 1
