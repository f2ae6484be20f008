import numpy as np
import pytest
import torch

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission.run_folder import RunFolder
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import TorchEngine
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_file import load_field
from mulan.reconstruction.pictures import render_picture
from mulan.reconstruction.sub_pixels import lattice, random_diagonals, spread_directions
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import NoWeights

from .cube_scene import cube_images, look_at

CAMERA = PinholeCamera(12, 8, 15.0, 16.0, 6.5, 4.0)
T = look_at([2.0, 1.0, 0.5])
R = torch.tensor(T[:3, :3]).float()


def spread(camera: PinholeCamera, side: int) -> torch.Tensor:
    centres = torch.tensor(camera.pixel_directions().reshape(-1, 3) @ T[:3, :3].T).float()
    n = len(centres)
    focal_px = torch.tensor([camera.fx, camera.fy]).expand(n, 2)
    return spread_directions(centres, R.expand(n, 3, 3), focal_px, lattice(side).expand(n, side**2, 2))


def interleaved(camera: PinholeCamera, side: int) -> np.ndarray:
    """Pixel centres of a picture `side` times as fine, gathered by coarse pixel."""
    fine = camera.resized(camera.width * side, camera.height * side).pixel_directions() @ T[:3, :3].T
    blocks = fine.reshape(camera.height, side, camera.width, side, 3)
    return blocks.transpose(0, 2, 1, 3, 4).reshape(-1, 3)


@pytest.mark.parametrize("side", [1, 2, 3])
def test_spread_rays_are_the_pixel_centres_of_a_finer_picture(side):
    np.testing.assert_allclose(spread(CAMERA, side).numpy(), interleaved(CAMERA, side), atol=1e-6)


def test_neglecting_the_stretch_of_a_lens_moves_rays_by_a_few_hundredths_of_a_pixel():
    lens = PinholeCamera(135, 240, 171.9, 171.8, 69.3, 120.7, k1=0.0578, k2=-0.0805, p1=-0.001, p2=0.00016)
    off_rad = np.linalg.norm(spread(lens, 2).numpy() - interleaved(lens, 2), axis=1)
    assert off_rad.max() * lens.fx < 0.05


def test_diagonals_are_lattice_points_of_both_kinds_about_the_centre():
    offset = random_diagonals(200, torch.Generator().manual_seed(0))
    assert (offset.sum(1) == 0).all()
    assert (offset.abs() == 0.25).all()
    rising = offset[:, 1].prod(-1) < 0
    assert 50 < int(rising.sum()) < 150


def test_a_pair_of_rays_shares_its_pixel(tmp_path):
    images = cube_images(tmp_path, train=3)
    data = ImageTensors(load_captured(images.train, None))
    batch = data.sample_pairs(100, torch.Generator().manual_seed(0))
    assert len(batch.weights) == 100
    assert batch.rays_a_pixel == 2
    assert torch.equal(batch.colours[::2], batch.colours[1::2])
    T_world_camera = data.T_world_camera[batch.image_index]
    in_camera = torch.einsum("rji,rj->ri", T_world_camera[:, :3, :3], batch.directions)
    pixel = images.train[0].camera.project(in_camera.double().numpy())
    np.testing.assert_allclose(np.abs(pixel - np.floor(pixel) - 0.5), 0.25, atol=1e-3)
    assert np.array_equal(np.floor(pixel)[::2], np.floor(pixel)[1::2])


def test_an_antialiased_picture_is_the_mean_of_a_finer_one():
    field = FieldConfig(levels=3, log2_table_size=9, finest_resolution=32, width=8, geometry_features=4)
    space = SceneSpace((0.0, 0.0, 0.0), 1.0, False)
    engine = TorchEngine(field, MarchConfig(steps=32, occupancy_resolution=8), space, True)
    with torch.no_grad():
        engine.field.table.mul_(1e5)
    fine = render_picture(engine, CAMERA.resized(24, 16), T, 24).astype(float)
    coarse = render_picture(engine, CAMERA, T, 12, sub_pixels=2)
    assert fine.std() > 5
    np.testing.assert_allclose(coarse, fine.reshape(8, 2, 12, 2, 3).mean((1, 3)), atol=1)


@pytest.mark.parametrize(("share", "sub_pixels"), [(0.0, 1), (0.5, 2)])
def test_a_field_file_tells_how_its_pictures_are_made(tmp_path, share, sub_pixels):
    field = FieldConfig(levels=4, log2_table_size=11, base_resolution=8, finest_resolution=48, width=16)
    config = TrainConfig(image_size=24, steps=4, batch_samples=512, antialias_share=share, field=field)
    run = RunFolder(tmp_path / "run")
    train(cube_images(tmp_path), NoWeights(), config, run)
    assert load_field(run.field)[1].sub_pixels == sub_pixels


def test_a_share_beyond_one_is_refused(tmp_path):
    with pytest.raises(InputError, match="antialias-share"):
        train(cube_images(tmp_path), NoWeights(), TrainConfig(antialias_share=2.0), RunFolder(tmp_path))
