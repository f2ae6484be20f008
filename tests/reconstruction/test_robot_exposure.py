from dataclasses import replace

import numpy as np
import pytest
import torch

from mulan.geometry import se3
from mulan.mission.pixels import encode_png, load_resized
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.radiance.config import FieldConfig
from mulan.radiance.engine import Rendering
from mulan.radiance.kernels.native_library import find_native_library
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.held_out import evaluate_held_out
from mulan.reconstruction.refinement.refine import refine_and_train
from mulan.reconstruction.robot_exposure import RobotExposure, log_gains
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import NoWeights

from .cube_scene import cube_images
from .refinement.test_refine import QUICK

FIELD = FieldConfig(levels=4, log2_table_size=11, base_resolution=8, finest_resolution=48, width=16)
TRAINING = TrainConfig(image_size=32, steps=500, batch_samples=2048, checkpoint_every_s=1e9, field=FIELD)
GAIN = np.array([0.6, 0.75, 0.9])


def through_another_camera(image, gain):
    """The photograph as a camera of other gains would have taken it; the cut-out stays."""
    pixels = load_resized(image.path, None).copy()
    pixels[..., :3] /= np.maximum(pixels[..., 3:], 1e-6)
    pixels[..., :3] *= gain
    path = image.path.with_name(f"dark_{image.path.name}")
    path.write_bytes(encode_png((pixels.clip(0, 1) * 255).round().astype(np.uint8)))
    return replace(image, path=path)


def two_robots(folder, gain=None):
    """Every other photograph by beta, whose camera may be another one."""
    images = cube_images(folder, train=24, test=3, side=32)
    train = []
    for i, image in enumerate(images.train):
        named = replace(image, robot_id="ab"[i % 2])
        train.append(through_another_camera(named, gain) if gain is not None and i % 2 else named)
    return PosedImageSet(tuple(train), images.test, folder)


def learnt(images, folder, exposure):
    result = train(images, NoWeights(), replace(TRAINING, robot_exposure=exposure), RunFolder(folder))
    scores = evaluate_held_out(
        result.engine, result.test, RunFolder(folder), 0, result.description.sub_pixels, (), result.exposure
    )
    return result, scores["psnr_db"]


def test_robots_whose_cameras_differ_learn_as_well_as_equal_ones(tmp_path):
    (tmp_path / "same").mkdir()
    equal, different = two_robots(tmp_path / "same"), two_robots(tmp_path, GAIN)
    _, reference_db = learnt(equal, tmp_path / "equal", exposure=False)
    _, ignored_db = learnt(different, tmp_path / "ignored", exposure=False)
    result, corrected_db = learnt(different, tmp_path / "corrected", exposure=True)
    assert ignored_db < reference_db - 1.5
    assert corrected_db > reference_db - 0.5
    assert result.exposure is not None
    np.testing.assert_allclose(result.exposure.gains["b"], GAIN, rtol=0.04)
    assert result.exposure.gains["a"] == [1, 1, 1]


def test_equal_cameras_are_found_equal(tmp_path):
    result, _ = learnt(two_robots(tmp_path), tmp_path / "run", exposure=True)
    assert result.exposure is not None
    np.testing.assert_allclose(result.exposure.gains["b"], 1, rtol=0.03)


@pytest.mark.skipif(find_native_library()[0] is None, reason="slow without the native engine")
def test_gains_are_found_while_poses_are_refined(tmp_path):
    images, rng = two_robots(tmp_path, GAIN), np.random.default_rng(0)
    sigma = np.array([0.02, 0.02, 0.02, 0.06, 0.06, 0.06])
    off = tuple(
        replace(
            image,
            T_world_camera=image.T_world_camera @ se3.exp(sigma * rng.normal(size=6)),
            pose_covariance=np.diag(sigma**2),
        )
        if image.robot_id == "b"
        else image
        for image in images.train
    )
    config = replace(TRAINING, steps=200, robot_exposure=True)
    run = RunFolder(tmp_path / "run")
    run.root.mkdir()
    refined = refine_and_train(replace(images, train=off), NoWeights(), config, QUICK, run, lambda *_: None)
    assert refined.doubted == ()
    assert refined.training.exposure is not None
    np.testing.assert_allclose(refined.training.exposure.gains["b"], GAIN, rtol=0.08)


def test_a_held_out_view_is_shown_in_the_colours_of_its_own_robot(tmp_path):
    images = two_robots(tmp_path)
    exposure = RobotExposure(images.train, 0)
    exposure.log_gain[1] = np.log(GAIN)
    alpha, beta = load_captured(images.train[:2], 32)
    opacity = torch.tensor([1.0, 0.5, 0.0])
    white = (1 - opacity)[:, None]
    colour = (0.8 * opacity[:, None] + white).expand(3, 3)
    rendering = Rendering(colour, torch.ones(3), opacity, torch.zeros(3))
    assert torch.equal(exposure.shown(rendering, alpha).colour, rendering.colour)
    other = replace(alpha, posed=replace(alpha.posed, robot_id="held_out"))
    assert torch.equal(exposure.shown(rendering, other).colour, rendering.colour)
    own = 0.8 * opacity[:, None] * torch.from_numpy(GAIN).float() + white
    torch.testing.assert_close(exposure.shown(rendering, beta).colour, own)


def test_gains_pass_from_robot_to_robot_where_the_first_and_last_share_no_place():
    true = np.array([[0, 0, 0], [0.3, -0.2, 0.1], [-0.4, 0.5, 0.2], [0, 0, 0]])
    trust = np.zeros((4, 4, 3))
    trust[0, 1], trust[1, 2] = 100.0, 40.0  # the last robot sees nothing the others see
    told = trust * (true[None] - true[:, None])
    np.testing.assert_allclose(log_gains(told, trust), true, atol=1e-3)


def test_a_stopped_training_goes_on_with_its_gains(tmp_path):
    images = two_robots(tmp_path)
    before, after = RobotExposure(images.train, 0), RobotExposure(images.train, 0)
    before.log_gain[1] = np.log(GAIN)
    saved = before.state()
    after.load_state(saved)
    assert not saved
    np.testing.assert_array_equal(after.log_gain, before.log_gain)
    with pytest.raises(ValueError, match="other robots"):
        RobotExposure(images.train[:1], 0).load_state(before.state())
    with pytest.raises(ValueError, match="lacks"):
        after.load_state({})
