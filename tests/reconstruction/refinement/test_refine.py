"""From uncertain poses to a field and corrected poses."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from mulan.geometry import se3
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.pixels import encode_png
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.radiance.kernels.native_library import find_native_library
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.refinement.anchored import anchored_images
from mulan.reconstruction.refinement.pose_tracker import PoseTracker
from mulan.reconstruction.refinement.refine import at_poses, image_names, pose_state, refine_and_train
from mulan.reconstruction.refinement.refinement_config import AllAroundConfig, CoarseStage, RefinementConfig
from mulan.reconstruction.refinement.registration import register
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import NoWeights
from tests.reconstruction.cube_scene import cube_images

QUICK = RefinementConfig(
    first=CoarseStage(3, 3, 80),
    stages=(CoarseStage(3, 4, 40), CoarseStage(1, 6, 80)),
    first_pose_steps=4,
    rays=128,
    batch_samples=2**12,
    final_every=50,
)
CONFIG = TrainConfig(image_size=40, steps=200, batch_samples=2**12)
SIGMA = np.array([0.02, 0.02, 0.02, 0.06, 0.06, 0.06])


@pytest.fixture
def uncertain(tmp_path):
    """Twelve images of an exact robot and twelve of one that is off, and where the latter were."""
    folder = tmp_path / "photographs"
    folder.mkdir()
    images = cube_images(folder, train=24, test=2, side=40)
    rng, train = np.random.default_rng(0), []
    for i, image in enumerate(images.train):
        if i % 2:
            T = image.T_world_camera @ se3.exp(SIGMA * rng.normal(size=6))
            image = replace(image, T_world_camera=T, pose_covariance=np.diag(SIGMA**2))
        train.append(replace(image, robot_id="beta" if i % 2 else "alpha"))
    true = np.stack([image.T_world_camera for image in images.train[1::2]])
    return PosedImageSet(tuple(train), images.test, images.source), true


def shifts_px(images, true):
    """How far the cube's corners are from where they belong in each uncertain image."""
    T = np.stack([image.T_world_camera for image in images.train[1::2]])
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    camera = images.train[0].camera
    pixels = []
    for poses in (T, true):
        to_camera = se3.inverse(poses)
        seen = corners @ np.swapaxes(to_camera[:, :3, :3], 1, 2) + to_camera[:, None, :3, 3]
        pixels.append(camera.project(seen))
    return np.linalg.norm(pixels[0] - pixels[1], axis=-1).mean(1)


needs_native = pytest.mark.skipif(find_native_library()[0] is None, reason="slow without the native engine")


@needs_native
def test_poses_come_right_while_the_field_is_learnt(uncertain, tmp_path):
    images, true = uncertain
    run = RunFolder(tmp_path / "run")
    run.root.mkdir()
    refined = refine_and_train(images, NoWeights(), CONFIG, QUICK, run, lambda *_: None)
    assert np.median(shifts_px(refined.images, true)) < 0.4 * np.median(shifts_px(images, true))
    for before, after in zip(images.train[::2], refined.images.train[::2], strict=True):
        assert np.array_equal(before.T_world_camera, after.T_world_camera)
    written = read_transforms(run.root / "transforms_refined.json")
    assert np.allclose(written.train[1].T_world_camera, refined.images.train[1].T_world_camera)
    assert written.train[1].pose_covariance is not None
    assert refined.doubted == ()
    # a cube of 40 pixels, 200 steps: the covariance must be of the error's order, not a hundredth of it
    errors = [
        se3.log(se3.inverse(i.T_world_camera) @ T)
        for i, T in zip(refined.images.train[1::2], true, strict=True)
    ]
    believed = [image.pose_covariance for image in refined.images.train[1::2]]
    nees = [
        xi @ np.linalg.solve(cov, xi) / 6 for xi, cov in zip(errors, believed, strict=True) if cov is not None
    ]
    assert len(nees) == 12
    assert 0.1 < np.mean(nees) < 4


@needs_native
def test_a_stopped_refinement_goes_on_to_the_same_end(uncertain, tmp_path):
    images, _ = uncertain
    ends = []
    for name, stops in (("whole", False), ("stopped", True)):
        run = RunFolder(tmp_path / name)
        run.root.mkdir()

        def stop(done, total, words, stops=stops):
            if stops and words.startswith("train") and done > 0.5:
                raise KeyboardInterrupt

        if stops:
            with pytest.raises(KeyboardInterrupt):
                refine_and_train(images, NoWeights(), CONFIG, QUICK, run, stop)
        refined = refine_and_train(images, NoWeights(), CONFIG, QUICK, run, lambda *_: None)
        ends.append(np.stack([image.T_world_camera for image in refined.images.train]))
    assert np.array_equal(*ends)


@needs_native
def test_an_image_of_something_else_is_left_out_and_named(uncertain, tmp_path):
    images, _ = uncertain
    odd = images.train[3]
    noise = np.random.default_rng(1).integers(0, 255, (40, 40, 4), dtype=np.uint8)
    noise[..., 3] = 255
    path = tmp_path / "elsewhere.png"
    path.write_bytes(encode_png(noise))
    train_images = list(images.train)
    train_images[3] = replace(odd, path=path)
    run = RunFolder(tmp_path / "run")
    run.root.mkdir()
    mixed = replace(images, train=tuple(train_images))
    refined = refine_and_train(mixed, NoWeights(), CONFIG, QUICK, run, lambda *_: None)
    assert [image.path for image in refined.doubted] == [path]
    assert image_names(refined.doubted) == ["beta/elsewhere.png"]
    assert np.array_equal(refined.images.train[3].T_world_camera, odd.T_world_camera)
    kept = refined.images.train[3].pose_covariance
    assert kept is not None
    assert np.array_equal(kept, np.diag(SIGMA**2))
    assert np.isfinite(refined.training.history[-1]["train_psnr_db"])


def test_exact_poses_are_left_alone(tmp_path):
    images = cube_images(tmp_path, train=6, test=0, side=16)
    run = RunFolder(tmp_path / "run")
    run.root.mkdir()
    config = TrainConfig(image_size=16, steps=3, batch_samples=2**10)
    refined = refine_and_train(images, NoWeights(), config, QUICK, run, lambda *_: None)
    assert refined.images is images


def test_registration_starts_from_the_robot_known_best(uncertain):
    images, _ = uncertain
    known = anchored_images(load_captured(images.train, 16))
    assert known.tolist() == [True, False] * 12
    vague = replace(
        images,
        train=tuple(
            replace(i, pose_covariance=np.eye(6) * (1 + (i.robot_id == "beta"))) for i in images.train
        ),
    )
    assert anchored_images(load_captured(vague.train, 16)).tolist() == [True, False] * 12


@needs_native
@pytest.mark.parametrize("opaque", [False, True])
def test_before_a_background_registration_begins_once_more_from_the_anchor(tmp_path, opaque):
    images = cube_images(tmp_path, train=16, test=0, side=32, opaque=opaque)
    G = se3.exp(np.array([0.02, -0.02, 0.04, 0.08, 0.06, -0.08]))
    train = tuple(
        replace(
            image, robot_id="beta", T_world_camera=G @ image.T_world_camera, pose_covariance=np.diag(SIGMA**2)
        )
        if i % 2
        else replace(image, robot_id="alpha")
        for i, image in enumerate(images.train)
    )
    state = pose_state(replace(images, train=train))
    assert state is not None
    true = np.stack([image.T_world_camera for image in images.train[1::2]])
    config = replace(QUICK, all_around=AllAroundConfig(CoarseStage(1, 16, 150), CoarseStage(1, 16, 150)))
    counted = []
    lost = register(
        load_captured(train, 32), state, config, 0, lambda done, total, _: counted.append((done, total))
    )
    steps = 80 + 40 + 80 + (300 if opaque else 0)
    assert counted[-1] == (steps, steps)
    assert not lost.any()
    if opaque:
        displaced = replace(images, train=train)
        after_px = shifts_px(at_poses(displaced, state, None), true)
        assert np.median(after_px) < 0.5 * np.median(shifts_px(displaced, true))


@needs_native
def test_before_a_background_the_final_field_begins_with_the_anchor(tmp_path, monkeypatch):
    images = cube_images(tmp_path, train=8, test=0, side=24, opaque=True)
    train = tuple(
        replace(image, robot_id="beta", pose_covariance=np.diag(SIGMA**2))
        if i % 2
        else replace(image, robot_id="alpha")
        for i, image in enumerate(images.train)
    )
    brief = CoarseStage(1, 16, 10)
    config = replace(QUICK, first=brief, stages=(brief,), all_around=AllAroundConfig(brief, brief, 0.3, 5))
    seen = []

    class Watched(PoseTracker):
        """Notes how many photographs rest after each step."""

        def after_step(self, engine, data, steps, fraction_done):
            super().after_step(engine, data, steps, fraction_done)
            seen.append((fraction_done, 0 if data.rests is None else int(data.rests.sum())))

    monkeypatch.setattr("mulan.reconstruction.refinement.refine.PoseTracker", Watched)
    run = RunFolder(tmp_path / "run")
    run.root.mkdir()
    training = TrainConfig(image_size=24, steps=40, batch_samples=2**11)
    refine_and_train(replace(images, train=train), NoWeights(), training, config, run, lambda *_: None)
    assert {resting for done, resting in seen if done < 0.3} == {4}
    assert {resting for done, resting in seen if done >= 0.3} == {0}


def test_photographs_that_rest_have_no_weight(tmp_path):
    data = ImageTensors(load_captured(cube_images(tmp_path, train=3, test=0, side=8).train, 8))
    data.rests = torch.tensor([False, True, False])
    for draw in (data.sample, data.sample_pairs):
        batch = draw(64, torch.Generator().manual_seed(0))
        assert torch.equal(batch.weights > 0, batch.image_index != 1)
