import json
from dataclasses import replace

import pytest
import torch

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.radiance.config import FieldConfig
from mulan.reconstruction.field_file import load_engine
from mulan.reconstruction.held_out import evaluate_held_out
from mulan.reconstruction.paper_weights import PaperWeights
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import NoWeights

from .cube_scene import cube_images

FIELD = FieldConfig(levels=4, log2_table_size=11, base_resolution=8, finest_resolution=48, width=16)
QUICK = TrainConfig(image_size=24, steps=30, batch_samples=2048, checkpoint_every_s=0.0, field=FIELD)


class StoppedError(Exception):
    pass


def stop_after(steps):
    def progress(status):
        if status.steps == steps:
            raise StoppedError

    return progress


def stopped_run(images, folder, steps=13):
    run = RunFolder(folder)
    with pytest.raises(StoppedError):
        train(images, NoWeights(), QUICK, run, stop_after(steps))
    return run


def test_resuming_a_killed_training_equals_never_having_stopped(tmp_path):
    images = cube_images(tmp_path)
    whole = train(images, NoWeights(), QUICK, RunFolder(tmp_path / "whole"))
    run = stopped_run(images, tmp_path / "resumed")
    resumed = train(images, NoWeights(), QUICK, run)
    a, b = whole.engine.state(), resumed.engine.state()
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert resumed.steps == 30
    assert whole.samples == resumed.samples
    assert not run.checkpoint.exists()


def test_seconds_of_learning_carry_on_across_a_stop(tmp_path):
    images = cube_images(tmp_path)
    run = stopped_run(images, tmp_path / "run")
    seen = []
    train(images, NoWeights(), QUICK, run, seen.append)
    assert seen[0].steps == 14
    assert seen[0].seconds > 0
    assert [s.seconds for s in seen] == sorted(s.seconds for s in seen)


@pytest.mark.parametrize(
    ("change", "weighting", "field"),
    [
        ({"seed": 1}, NoWeights(), "seed"),
        ({"batch_samples": 1024}, NoWeights(), "batch_samples"),
        ({}, PaperWeights(), "weighting"),
    ],
)
def test_other_options_do_not_resume_and_the_option_is_named(tmp_path, change, weighting, field):
    images = cube_images(tmp_path)
    run = stopped_run(images, tmp_path / "run", steps=2)
    with pytest.raises(InputError) as caught:
        train(images, weighting, replace(QUICK, **change), run)
    assert caught.value.field == field
    assert str(run.checkpoint) in str(caught.value)


def test_other_images_do_not_resume(tmp_path):
    images = cube_images(tmp_path)
    run = stopped_run(images, tmp_path / "run", steps=2)
    with pytest.raises(InputError, match="images"):
        train(PosedImageSet(images.train[:-1] + images.train[:1], (), tmp_path), NoWeights(), QUICK, run)


def test_a_damaged_checkpoint_is_named(tmp_path):
    images = cube_images(tmp_path)
    run = stopped_run(images, tmp_path / "run", steps=2)
    run.checkpoint.write_bytes(run.checkpoint.read_bytes()[:500])
    with pytest.raises(InputError, match="checkpoint"):
        train(images, NoWeights(), QUICK, run)


def test_trained_field_comes_back_from_its_file_and_renders_the_held_out_views(tmp_path):
    images = cube_images(tmp_path)
    run = RunFolder(tmp_path / "run")
    result = train(images, NoWeights(), replace(QUICK, steps=250, checkpoint_every_s=1e9), run)
    engine = load_engine(run.field)
    figures = evaluate_held_out(engine, result.test, run, keep=2, sub_pixels=2)
    assert figures == evaluate_held_out(result.engine, result.test, run, keep=0, sub_pixels=2)
    assert figures["psnr_db"] > 17
    assert figures["ssim"] > 0.6
    assert len(figures["views"]) == 2
    assert sorted(p.name for p in run.renders.iterdir()) == [
        f"{i:03d}_{what}.png" for i in range(2) for what in ("depth", "rendered", "true")
    ]
    history = json.loads(run.history.read_text())
    assert set(history[-1]) == {"seconds", "steps", "loss", "train_psnr_db", "test_psnr_db"}
    assert history[-1]["steps"] == 250


def test_time_budget_ends_a_training(tmp_path):
    config = replace(QUICK, steps=None, time_budget_s=0.3)
    result = train(cube_images(tmp_path), NoWeights(), config, RunFolder(tmp_path / "run"))
    assert 0.3 <= result.seconds < 3
    assert result.steps > 1


def test_no_photographs_or_a_senseless_option_is_one_sentence(tmp_path):
    images = cube_images(tmp_path)
    with pytest.raises(InputError, match="none to learn from"):
        train(PosedImageSet((), images.test, tmp_path), NoWeights(), QUICK, RunFolder(tmp_path))
    with pytest.raises(InputError, match="image-size"):
        train(images, NoWeights(), replace(QUICK, image_size=0), RunFolder(tmp_path))


def test_a_file_that_is_no_field_is_refused(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        load_engine(tmp_path / "none.safetensors")
    (tmp_path / "bad.safetensors").write_bytes(b"not a field")
    with pytest.raises(InputError, match="cannot be read"):
        load_engine(tmp_path / "bad.safetensors")
