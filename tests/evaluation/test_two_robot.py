import json
from pathlib import Path

import pytest

from mulan.cli.main import run_command


def evaluate(data: Path, out: Path, *more: str) -> dict:
    arguments = ["evaluate", "two-robot", "--data", str(data), "--out", str(out), "--seed", "0"]
    assert run_command([*arguments, *more]) == 0
    return json.loads((out / "metrics.json").read_text())


@pytest.mark.data
@pytest.mark.parametrize("name", ["nerf_synthetic_lego", "fox"])
def test_two_robot_scores_all_three_setups_on_real_images(name: str, data: Path, tmp_path: Path):
    metrics = evaluate(
        data / name, tmp_path / "run", "--image-size", "40", "--time-budget", "4", "--tour.rounds", "4"
    )
    assert list(metrics["setups"]) == ["oracle", "wireless", "uncertainty"]
    for setup in metrics["setups"].values():
        assert 8 < setup["psnr_db"] < 50
        assert 0 < setup["ssim"] < 1
    assert metrics["setups"]["oracle"]["camera_rms_m"] == 0
    assert 0 < metrics["setups"]["wireless"]["camera_rms_m"] < 0.5
    assert (tmp_path / "run" / "report.html").is_file()
