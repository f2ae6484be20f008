import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError


def one_sentence(arguments: list[str]) -> str:
    """What the real program prints on stderr; it must fail with one line and no traceback."""
    done = subprocess.run(
        [sys.executable, "-c", "from mulan.cli.main import main; main()", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    return done.stderr.strip()


def test_truncated_bag_is_named(bag: Path, tmp_path: Path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    message = one_sentence(["run", str(cut), "--out", str(tmp_path / "run")])
    assert "cut.mcap" in message


def test_missing_bag_is_named(tmp_path: Path):
    assert "nowhere.mcap" in one_sentence(["localize", "nowhere.mcap", "--out", str(tmp_path / "run")])


def test_missing_image_is_named(finished_run: Path, tmp_path: Path):
    copy = tmp_path / "run"
    shutil.copytree(finished_run, copy)
    next((copy / "images" / "alpha").iterdir()).unlink()
    with pytest.raises(InputError, match="images/alpha"):
        run_command(["train", str(copy), "--image-size", "32", "--steps", "3"])


def test_nan_pose_names_its_frame(finished_run: Path, tmp_path: Path):
    copy = tmp_path / "run"
    shutil.copytree(finished_run, copy)
    transforms = json.loads((copy / "transforms.json").read_text())
    transforms["frames"][3]["transform_matrix"][0][3] = float("nan")
    (copy / "transforms.json").write_text(json.dumps(transforms))
    message = one_sentence(["train", str(copy)])
    assert "transforms.json" in message
    assert transforms["frames"][3]["file_path"] in message or "3" in message


def test_transforms_without_frames_are_refused(tmp_path: Path):
    (tmp_path / "transforms.json").write_text('{"fl_x": 50.0, "w": 64, "h": 64, "frames": []}')
    with pytest.raises(InputError, match="frames"):
        run_command(["simulate", "--images", str(tmp_path), "-o", str(tmp_path / "a.mcap")])


def test_unknown_command_is_one_sentence():
    assert "frobnicate" in one_sentence(["frobnicate"])


def test_killed_training_goes_on_where_it_was(finished_run: Path, tmp_path: Path):
    data = str(finished_run / "transforms.json")
    run = tmp_path / "run"
    arguments = ["train", str(run), "--data", data, "--image-size", "32", "--steps", "400"]
    arguments += ["--checkpoint-every-s", "0.2"]
    command = [sys.executable, "-c", "from mulan.cli.main import main; main()", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    deadline = time.monotonic() + 60
    while not (run / "checkpoint.safetensors").exists():
        assert process.poll() is None, "training ended before its first checkpoint"
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not (run / "field.safetensors").exists()
    resumed_from = (run / "checkpoint.safetensors").stat().st_mtime_ns
    assert run_command(arguments) == 0
    assert (run / "field.safetensors").stat().st_mtime_ns > resumed_from
    assert json.loads((run / "metrics.json").read_text())["steps"] == 400
    assert not (run / "checkpoint.safetensors").exists()


def test_interrupted_training_keeps_what_it_learnt(finished_run: Path, tmp_path: Path):
    run = tmp_path / "run"
    arguments = ["train", str(run), "--data", str(finished_run / "transforms.json"), "--image-size", "32"]
    arguments += ["--steps", "100000"]
    command = [sys.executable, "-c", "from mulan.cli.main import main; main()", *arguments]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        # a shell's background job hands down ignored interrupts
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None
    while not process.stdout.readline().startswith("Training"):
        assert process.poll() is None
    time.sleep(4)  # images are read in a fraction of this
    process.send_signal(signal.SIGINT)
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "run the same command again" in printed
    assert (run / "checkpoint.safetensors").is_file()


def test_a_folder_that_cannot_be_written_is_found_before_training(finished_run: Path, tmp_path: Path):
    (tmp_path / "file").write_text("not a folder")
    data = str(finished_run / "transforms.json")
    with pytest.raises(InputError, match="can write to"):
        run_command(["train", str(tmp_path / "file"), "--data", data, "--image-size", "32", "--steps", "3"])
