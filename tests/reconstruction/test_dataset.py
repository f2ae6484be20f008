from dataclasses import replace

import numpy as np
import pytest
import torch

from mulan.geometry.camera import PinholeCamera
from mulan.mission.pixels import encode_png
from mulan.mission.posed_images import PosedImage
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors

from .cube_scene import cube_images, look_at, photograph


def test_transparent_pixels_become_white_and_keep_their_coverage(tmp_path):
    image = load_captured(cube_images(tmp_path, train=1).train, None)[0]
    assert image.alpha is not None
    assert (image.colour[image.alpha == 0] == 255).all()
    assert (image.alpha == 255).any()


def test_every_ray_hits_the_surface_point_its_colour_names(tmp_path):
    data = ImageTensors(load_captured(cube_images(tmp_path, train=3).train, None))
    batch = data.sample(500, torch.Generator().manual_seed(0))
    a, b = (-0.5 - batch.origins) / batch.directions, (0.5 - batch.origins) / batch.directions
    near, far = torch.minimum(a, b).amax(-1), torch.maximum(a, b).amin(-1)
    surface = batch.origins + near[:, None] * batch.directions + 0.5
    hit = far - near > 0.01
    assert hit.sum() > 50
    torch.testing.assert_close(batch.colours[hit], surface[hit], atol=0.01, rtol=0)
    torch.testing.assert_close(batch.directions.norm(dim=-1), torch.ones(500))


def test_images_of_different_sizes_and_lenses_keep_their_own_rays(tmp_path):
    wide, tall = PinholeCamera(12, 8, 15.0, 15.0, 6.0, 4.0), PinholeCamera(6, 10, 9.0, 11.0, 3.0, 5.0)
    cameras = [wide, tall, wide]
    posed = []
    for i, camera in enumerate(cameras):
        T = look_at([2.0 + i, 1.0, 0.5])
        path = tmp_path / f"{i}.png"
        path.write_bytes(encode_png(photograph(camera, T)))
        posed.append(PosedImage(path, camera, T))
    data = ImageTensors(load_captured(posed, None))
    for i, camera in enumerate(cameras):
        rays = data.image_rays(i)
        expected = camera.pixel_directions().reshape(-1, 3) @ posed[i].T_world_camera[:3, :3].T
        np.testing.assert_allclose(rays.directions.numpy(), expected, atol=1e-6)
        assert (rays.image_index == i).all()


def test_smaller_pictures_keep_the_mean_colour_and_the_field_of_view(tmp_path):
    images = cube_images(tmp_path, train=1)
    full, small = (load_captured(images.train, side)[0] for side in (None, 12))
    assert small.colour.shape == (12, 12, 3)
    assert abs(float(small.colour.mean()) - float(full.colour.mean())) < 0.5
    assert small.camera.fx / 12 == pytest.approx(full.camera.fx / 24)


def test_pixels_of_zero_weight_are_never_drawn(tmp_path):
    captured = load_captured(cube_images(tmp_path, train=2).train, None)
    maps = [torch.zeros(24, 24), torch.full((24, 24), 0.5)]
    maps[0][3, 4] = 1.0
    batch = ImageTensors(captured, maps).sample(5000, torch.Generator().manual_seed(0))
    assert (batch.weights > 0).all()
    assert set(batch.image_index.tolist()) == {0, 1}


def test_fingerprint_tells_sets_apart(tmp_path):
    captured = load_captured(cube_images(tmp_path, train=2).train, None)
    plain, weighted = ImageTensors(captured), ImageTensors(captured, [torch.full((24, 24), 0.5)] * 2)
    assert plain.fingerprint() == ImageTensors(captured).fingerprint() != weighted.fingerprint()


def test_rays_carry_the_coverage_of_their_pixel_where_every_image_has_one(tmp_path):
    captured = load_captured(cube_images(tmp_path, train=2).train, None)
    batch = ImageTensors(captured).image_rays(1)
    alpha = captured[1].alpha
    assert alpha is not None
    assert batch.opacity is not None
    torch.testing.assert_close(batch.opacity, torch.from_numpy(alpha).view(-1).float() / 255)
    opaque = replace(captured[1], alpha=None)
    assert ImageTensors([captured[0], opaque]).image_rays(0).opacity is None


def test_moved_pixels_make_their_rays_where_they_are(tmp_path):
    data = ImageTensors(load_captured(cube_images(tmp_path, train=2).train, None))
    data.sample(4, torch.Generator().manual_seed(0))
    # the other device that every machine has: it knows shapes only, and refuses to mix devices
    data.move_to(torch.device("meta"))
    batch = data.sample(50, torch.Generator().manual_seed(0))
    assert {x.device.type for x in (batch.origins, batch.directions, batch.colours, batch.weights)} == {
        "meta"
    }
    assert batch.origins.shape == batch.colours.shape == (50, 3)
