import json
from dataclasses import replace

import numpy as np
import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.evaluation.table1.protocol import Table1Config, table1
from mulan.evaluation.table1.setups import SETUPS
from mulan.evaluation.table1.sources import Noise, PaperSource
from mulan.evaluation.table1.team import Split
from mulan.evaluation.table1.trained_setup import aligned_psnr_db
from mulan.geometry import se3
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.radiance.config import FieldConfig
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import NoWeights

from ...reconstruction.cube_scene import cube_images

FIELD = FieldConfig(levels=4, log2_table_size=11, base_resolution=8, finest_resolution=48, width=16)
TRAINING = TrainConfig(image_size=24, steps=120, batch_samples=2048, checkpoint_every_s=1e9, field=FIELD)


def run_table(images, folder, only=("A", "B", "alone"), steps=120):
    said = []
    config = Table1Config(1, 0, only, replace(TRAINING, steps=steps))
    source = PaperSource(images, Split.AZIMUTH, Noise.EQUAL)
    metrics = table1(source, config, RunFolder(folder), lambda _: lambda *_: None, said.append)
    return metrics, said


def test_wireless_poses_cost_quality_and_the_table_says_how_much(tmp_path):
    images = cube_images(tmp_path, train=12, test=2)
    metrics, said = run_table(images, tmp_path / "out")
    setups = metrics["setups"]
    assert list(setups) == ["A", "B", "alone"]
    assert setups["A"]["psnr_db"]["mean"] > setups["B"]["psnr_db"]["mean"] + 1
    assert setups["A"]["camera_rms_m"] == setups["alone"]["camera_rms_m"] == 0
    assert 0.1 < setups["B"]["camera_rms_m"] < 1
    assert setups["A"]["lpips"] is None
    assert 0 < setups["A"]["ause"] < 2
    assert len(said) == 3
    assert json.loads((tmp_path / "out" / "metrics.json").read_text()) == metrics
    assert (tmp_path / "out" / "psnr.png").is_file()
    assert (tmp_path / "out" / "views.png").is_file()


def test_finished_setups_are_kept_and_a_changed_option_learns_anew(tmp_path):
    images = cube_images(tmp_path, train=12, test=1)
    first, _ = run_table(images, tmp_path / "out", only=("A",), steps=20)
    metrics, said = run_table(images, tmp_path / "out", only=("alone",), steps=20)
    assert len(said) == 1
    assert list(metrics["setups"]) == ["A", "alone"]
    assert metrics["setups"]["A"] == first["setups"]["A"]
    _, said = run_table(images, tmp_path / "out", only=("A",), steps=21)
    assert len(said) == 1


def test_moving_the_whole_map_costs_raw_quality_but_none_once_aligned(tmp_path):
    images = cube_images(tmp_path, train=12, test=2)
    shift = se3.exp(np.array([0.1, -0.05, 0.3, 0.4, -0.2, 0.3]))
    moved = tuple(replace(image, T_world_camera=shift @ image.T_world_camera) for image in images.train)
    elsewhere = PosedImageSet(moved, images.test, tmp_path)
    training = train(elsewhere, NoWeights(), replace(TRAINING, steps=120), RunFolder(tmp_path / "run"))
    at_home = train(images, NoWeights(), replace(TRAINING, steps=120), RunFolder(tmp_path / "home"))
    aligned = aligned_psnr_db(training, images, elsewhere, 0.0)
    reference = aligned_psnr_db(at_home, images, elsewhere, 0.0)
    same = aligned_psnr_db(at_home, images, images, 12.5)
    assert same == 12.5
    assert aligned > reference + 3


def test_unknown_setups_and_no_seeds_are_one_sentence(tmp_path):
    images = cube_images(tmp_path, train=12, test=1)
    with pytest.raises(InputError, match=r"setup 'D'.*choose from A, B"):
        run_table(images, tmp_path / "out", only=("D",))
    with pytest.raises(InputError, match="--seeds"):
        table1(PaperSource(images), Table1Config(0), RunFolder(tmp_path), lambda _: lambda *_: None, print)


def test_the_command_writes_the_table_of_any_posed_image_set(tmp_path, capsys):
    images = cube_images(tmp_path, train=12, test=2)
    write_transforms(images, tmp_path / "transforms.json")
    out = tmp_path / "out"
    arguments = ["evaluate", "table1", "--data", str(tmp_path), "--out", str(out), "--seeds", "1"]
    more = ["--image-size", "24", "--steps", "4", "--only", "A,C", "--noise", "spread"]
    assert run_command([*arguments, *more]) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    assert list(metrics["setups"]) == ["A", "C"]
    assert set(metrics["gap_recovered"]) == {"C"}
    assert "C  paper's weights" in capsys.readouterr().out
    assert {setup.name for setup in SETUPS} >= set(metrics["setups"])
