import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from mulan.errors import InputError
from mulan.mission import pixels
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_file import load_engine
from mulan.reconstruction.held_out import psnr_db
from mulan.reconstruction.live_training import LiveTraining
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import NoWeights, UncertaintyWeights

from .cube_scene import cube_images
from .test_train import FIELD

CONFIG = TrainConfig(image_size=24, batch_samples=2048, field=FIELD)


def live(folder: Path, config: TrainConfig = CONFIG) -> LiveTraining:
    return LiveTraining(RunFolder(folder), config, NoWeights())


def scores(training: LiveTraining, images: PosedImageSet) -> np.ndarray:
    assert training.engine is not None
    shown = live(training.run.root / "scores")
    shown.show(images)
    data = ImageTensors(shown._shown.train)
    return np.array([psnr_db(training.engine, data, i) for i in range(len(data))])


def learn_steps(training: LiveTraining, steps: int) -> None:
    """As many steps on every machine; a time would be fewer on a busy one."""
    end = training.progress.steps + steps
    training.learn(math.inf, stop=lambda: training.progress.steps >= end)


def test_old_photographs_are_not_forgotten_while_new_ones_are_learnt(tmp_path: Path) -> None:
    images = cube_images(tmp_path, train=12)
    first, then = replace(images, train=images.train[:6]), replace(images, train=images.train[6:])
    kept, forgot = live(tmp_path / "run"), live(tmp_path / "forgetful")
    for training, shown_next in ((kept, images), (forgot, then)):
        training.show(first)
        learn_steps(training, 300)
        before = scores(training, first), scores(training, then)
        training.show(shown_next)
        learn_steps(training, 300)
    after = scores(kept, first), scores(kept, then)
    assert after[1].mean() > before[1].mean() + 1.0
    assert after[0].mean() > before[0].mean() - 0.3
    assert after[0].mean() > scores(forgot, first).mean() + 2.0
    assert kept.begun_anew == 0


def test_a_killed_live_training_goes_on_from_its_checkpoint(tmp_path: Path) -> None:
    images = cube_images(tmp_path)
    training = live(tmp_path / "run")
    training.show(images)
    training.learn(0.3)
    training.save()
    again = live(tmp_path / "run")
    assert again.engine is not None
    assert training.engine is not None
    a, b = training.engine.state(), again.engine.state()
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert again.progress == training.progress
    again.show(images)
    again.learn(0.1)
    again.save()
    assert again.progress.steps > training.progress.steps
    assert again.begun_anew == 0
    history = read_json(again.run.history, "a test")
    assert [point["steps"] for point in history] == [training.progress.steps, again.progress.steps]
    assert load_engine(again.run.field).state().keys() == a.keys()


def test_other_options_do_not_take_up_a_checkpoint(tmp_path: Path) -> None:
    training = live(tmp_path / "run")
    training.show(cube_images(tmp_path))
    training.learn(0.05)
    training.save()
    with pytest.raises(InputError, match="image_size"):
        live(tmp_path / "run", replace(CONFIG, image_size=12))


def test_the_rate_falls_only_in_the_end_and_the_field_gains_by_it(tmp_path: Path) -> None:
    images = cube_images(tmp_path)
    training = live(tmp_path / "run")
    training.show(images)
    training.learn(1.0)
    before = scores(training, images).mean()
    training.cool_down(0.5)
    assert scores(training, images).mean() > before


def test_a_scene_that_turns_out_to_be_elsewhere_is_begun_anew(tmp_path: Path) -> None:
    images = cube_images(tmp_path)
    training = live(tmp_path / "run")
    training.show(images)
    training.learn(0.05)
    steps = training.progress.steps

    def moved(image, by_m):
        T = image.T_world_camera.copy()
        T[0, 3] += by_m
        return replace(image, T_world_camera=T)

    training.show(replace(images, train=tuple(moved(image, 0.05) for image in images.train)))
    assert training.begun_anew == 0
    training.show(replace(images, train=tuple(moved(image, 3.0) for image in images.train)))
    assert training.begun_anew == 1
    assert training.description.space.centre_m[0] == pytest.approx(3.0, abs=0.1)
    assert training.progress.steps == steps, "what was spent stays counted"


def test_nothing_happens_before_a_photograph_was_shown(tmp_path: Path) -> None:
    training = live(tmp_path / "run")
    training.learn(1.0)
    training.cool_down(1.0)
    training.save()
    assert training.progress.steps == 0
    assert not training.run.field.exists()


def test_a_scene_stays_where_all_photographs_see_it_though_few_are_trusted_at_first(tmp_path: Path) -> None:
    """The anchor's photographs alone put the scene elsewhere; when the others' count too, nothing is lost."""
    images = cube_images(tmp_path, train=12)
    for image in images.train:  # opaque: where the scene lies is told by the cameras alone
        rgba = pixels.decode(image.path.read_bytes(), image.path.name)
        image.path.write_bytes(pixels.encode_png(rgba[..., :3]))
    sure, unsure = np.eye(6) * 1e-8, np.eye(6)

    def posed(image, index):
        T = image.T_world_camera.copy()
        T[0, 3] += 1.4 if index < 4 else 0.0
        return replace(image, T_world_camera=T, pose_covariance=sure if index < 4 else unsure)

    training = LiveTraining(RunFolder(tmp_path / "run"), CONFIG, UncertaintyWeights())
    training.show(replace(images, train=tuple(posed(image, i) for i, image in enumerate(images.train))))
    training.learn(0.05)
    training.show(replace(images, train=tuple(replace(i, pose_covariance=sure) for i in images.train)))
    assert training.begun_anew == 0
