import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mulan.cli.main import COMMANDS, run_command
from mulan.errors import InputError
from mulan.mission.nerfstudio import read_transforms
from mulan.wireless.calibration import AzimuthCalibration, write_calibration


def test_run_leaves_a_complete_run_folder(finished_run: Path):
    for name in (
        "config.json",
        "localization.json",
        "transforms.json",
        "field.safetensors",
        "metrics.json",
        "history.json",
        "plan.json",
        "plan.png",
        "report.html",
        "poses/alpha.tum",
        "poses/beta.json",
        "renders/000_rendered.png",
    ):
        assert (finished_run / name).is_file(), name
    assert not (finished_run / "checkpoint.safetensors").exists()


def test_run_finds_the_robots(finished_run: Path):
    accuracy = json.loads((finished_run / "localization.json").read_text())["accuracy"]
    assert accuracy["beta"]["position_rms_m"] < 0.3
    assert accuracy["beta"]["yaw_rms_deg"] < 5


def test_learning_beats_a_grey_picture(finished_run: Path):
    test = read_transforms(finished_run / "transforms.json").test
    photographs = [np.asarray(Image.open(image.path).convert("RGB")) / 255 for image in test]
    grey = np.mean([-10 * np.log10(((p - p.mean((0, 1))) ** 2).mean()) for p in photographs])
    assert json.loads((finished_run / "metrics.json").read_text())["psnr_db"] > grey + 1


def test_posed_images_carry_robot_time_and_covariance(finished_run: Path):
    frames = json.loads((finished_run / "transforms.json").read_text())["frames"]
    learnt = [frame for frame in frames if frame["robot_id"] != "held_out"]
    assert {frame["robot_id"] for frame in learnt} == {"alpha", "beta"}
    for frame in learnt:
        covariance = np.array(frame["pose_covariance"])
        assert covariance.shape == (6, 6)
        assert np.linalg.eigvalsh(covariance).min() > -1e-9
        assert frame["timestamp"] >= 0


def test_render_writes_pictures_and_an_animation(finished_run: Path, tmp_path: Path):
    out = tmp_path / "orbit"
    assert run_command(["render", str(finished_run), "--frames", "3", "--out", str(out)]) == 0
    assert len(list(out.glob("*.png"))) == 3
    assert getattr(Image.open(out / "animation.webp"), "n_frames", 1) == 3


def test_rendering_with_no_rays_a_pixel_is_refused(finished_run: Path, tmp_path: Path):
    with pytest.raises(InputError, match="sub-pixels"):
        run_command(["render", str(finished_run), "--sub-pixels", "0", "--out", str(tmp_path)])


def test_plan_and_report_work_on_a_finished_run(finished_run: Path):
    assert run_command(["plan", str(finished_run), "--columns", "6", "--candidates.distance-m", "0.3"]) == 0
    assert run_command(["report", str(finished_run)]) == 0
    assert "<html" in (finished_run / "report.html").read_text()[:200]


def test_training_twice_with_the_same_options_keeps_the_result(finished_run: Path):
    before = (finished_run / "field.safetensors").stat().st_mtime_ns
    assert run_command(["train", str(finished_run), "--image-size", "48", "--steps", "300"]) == 0
    assert (finished_run / "field.safetensors").stat().st_mtime_ns == before


@pytest.mark.parametrize("weighting", ["none", "paper", "uncertainty"])
def test_every_weighting_trains(finished_run: Path, tmp_path: Path, weighting: str):
    arguments = ["--weighting", weighting, "--image-size", "32", "--steps", "3"]
    run = str(tmp_path / "run")
    assert run_command(["train", run, "--data", str(finished_run / "transforms.json"), *arguments]) == 0
    assert json.loads((tmp_path / "run" / "metrics.json").read_text())["steps"] == 3
    assert run_command(["plan", run, "--columns", "4"]) == 0


def test_doctor_finds_all_needed_parts(capsys: pytest.CaptureFixture[str]):
    assert run_command(["doctor"]) == 0
    printed = capsys.readouterr().out
    for part in ("Python", "torch", "gtsam", "GPU", "MULAN_DATA"):
        assert part in printed


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]):
    with suppress(SystemExit):
        run_command([command, "--help"])
    assert f"mulan {command}" in capsys.readouterr().out


def test_profile_of_a_bag_is_drawn(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    calibration = tmp_path / "calibration.json"
    write_calibration(calibration, AzimuthCalibration(sigma_scale=2.0, sigma_floor_rad=0.01), {})
    for name, options in (("plain.png", []), ("calibrated.png", ["--calibration", str(calibration)])):
        arguments = ["aoa", str(bag), "--link", "alpha:beta", "--out", str(tmp_path / name), *options]
        assert run_command(arguments) == 0
        assert (tmp_path / name).stat().st_size > 20_000
    said = [line for line in capsys.readouterr().out.splitlines() if "truth" in line]
    assert len(said) == 2
    assert said[0] != said[1]
    with pytest.raises(InputError, match="alpha:gamma"):
        run_command(["aoa", str(bag), "--link", "alpha:gamma", "--out", str(tmp_path / "no.png")])
