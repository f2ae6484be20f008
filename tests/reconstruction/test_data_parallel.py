"""Two real processes on this machine against one."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.mission.nerfstudio import read_transforms, write_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.torchrun import is_leader, place_of_this_process, threads_for
from mulan.reconstruction.trainer import train
from mulan.reconstruction.weights import UncertaintyWeights
from tests.reconstruction.torchrun import torchrun
from tests.reconstruction.two_processes import BATCH_SAMPLES, CONFIG

from .cube_scene import cube_images

SCRIPT = str(Path(__file__).with_name("two_processes.py"))


def posed_images(folder: Path) -> None:
    """Posed images whose pixels deserve unlike weights, some of them none."""
    covariance = np.diag([1e-4] * 3 + [0.02] * 3)
    images = cube_images(folder, train=6, test=0).train
    uncertain = tuple(replace(image, pose_covariance=covariance * (i % 3)) for i, image in enumerate(images))
    write_transforms(PosedImageSet(uncertain, (), folder), folder / "transforms.json")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("images")
    posed_images(folder)
    return folder


@pytest.fixture(scope="module")
def told(folder: Path) -> list[dict[str, Any]]:
    """What the two processes said, in order."""
    done = torchrun(SCRIPT, str(folder))
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return sorted(lines, key=lambda values: values["rank"])


def test_both_processes_hold_the_same_field_bit_for_bit(told: list[dict[str, Any]]) -> None:
    # parameters, moments, occupancy grid, counters and generators
    assert told[0]["whole"] == told[1]["whole"]
    assert told[0]["whole_seconds"] == told[1]["whole_seconds"]


@pytest.mark.usefixtures("told")
def test_two_processes_have_the_loss_curve_of_one_with_the_double_batch(folder: Path) -> None:
    double = replace(CONFIG, batch_samples=2 * BATCH_SAMPLES)
    images = read_transforms(folder / "transforms.json")
    alone = train(images, UncertaintyWeights(), double, RunFolder(folder / "alone"))
    history = json.loads((folder / "whole" / "history.json").read_text())
    together, one = (np.array([point["loss"] for point in h]) for h in (history, alone.history))
    assert len(together) == len(one) == CONFIG.steps
    # the same rays and noise: only the order of the sums differs, which training amplifies slowly
    np.testing.assert_allclose(together[:8], one[:8], rtol=1e-5)
    np.testing.assert_allclose(together[:32], one[:32], rtol=1e-3)
    np.testing.assert_allclose(together[:96], one[:96], rtol=0.03)
    # once the occupancy grid drops cells (step 96) a cell at its threshold may change the count of rays drawn
    assert together[96:].mean() == pytest.approx(one[96:].mean(), rel=0.05)


def test_a_resumed_training_equals_one_that_never_stopped(told: list[dict[str, Any]]) -> None:
    for process in told:
        assert process["resumed"] == process["whole"]


def test_processes_agree_on_the_end_of_a_time_budget(told: list[dict[str, Any]]) -> None:
    steps, seconds = told[0]["timed"]
    assert told[1]["timed"] == [steps, seconds]
    assert steps > 1
    assert seconds >= 0.5


def test_a_failure_in_one_process_ends_the_other_with_its_reason(told: list[dict[str, Any]]) -> None:
    assert told[1]["failure"] == "ValueError no such ray"
    assert told[0]["failure"].startswith("InputError process 1 of 2: ")
    assert "no such ray" in told[0]["failure"]


def test_the_command_under_torchrun_writes_one_run(folder: Path) -> None:
    arguments = ["--data", str(folder), "--image-size", "24", "--steps", "20", "--hold-out-every", "3"]
    done = torchrun("-m", "mulan.cli.main", "train", str(folder / "run"), *arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Held-out views:") == 1
    assert sorted(p.name for p in (folder / "run").iterdir() if p.is_file()) == [
        "config.json",
        "field.safetensors",
        "history.json",
        "metrics.json",
        "transforms.json",
    ]


def test_an_unreadable_photograph_is_one_sentence_for_all_processes(tmp_path: Path) -> None:
    posed_images(tmp_path)
    (tmp_path / "02.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    done = torchrun("-m", "mulan.cli.main", "train", str(tmp_path / "run"), "--data", str(tmp_path))
    assert done.returncode != 0
    said = [line for line in done.stderr.splitlines() if line.startswith("error")]
    assert len(said) == 1
    assert "02.png" in said[0]


def test_other_commands_refuse_to_run_several_times_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RANK", "0")
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(InputError, match="runs in one process"):
        run_command(["doctor"])


def test_place_is_read_from_torchruns_environment() -> None:
    environment = {"RANK": "3", "WORLD_SIZE": "4", "LOCAL_RANK": "1", "LOCAL_WORLD_SIZE": "2"}
    place = place_of_this_process(environment)
    assert place is not None
    assert (place.rank, place.local_rank, place.leads) == (3, 1, False)
    assert not is_leader(environment)
    assert threads_for(place, {"OMP_NUM_THREADS": "5"}) == 5
    assert threads_for(place, {"OMP_NUM_THREADS": "1"}) >= 1
    assert place_of_this_process({}) is None
    assert place_of_this_process({"RANK": "0", "WORLD_SIZE": "1"}) is None
    assert is_leader({})
