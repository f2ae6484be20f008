import json
from pathlib import Path

import pytest

from mulan.cli.main import run_command


def evaluate(data: Path, out: Path, *more: str) -> dict:
    arguments = ["evaluate", "two-robot", "--data", str(data), "--out", str(out), "--seed", "0"]
    assert run_command([*arguments, *more]) == 0
    return json.loads((out / "metrics.json").read_text())


def thinned(source: Path, folder: Path, every: int) -> Path:
    """A real image set with every n-th of its photographs."""
    folder.mkdir()
    for entry in source.iterdir():
        if entry.suffix == ".json":
            description = json.loads(entry.read_text())
            description["frames"] = description["frames"][::every]
            (folder / entry.name).write_text(json.dumps(description))
        else:
            (folder / entry.name).symlink_to(entry.resolve())
    return folder


@pytest.mark.data
@pytest.mark.parametrize("name", ["nerf_synthetic_lego", "fox"])
def test_two_robot_scores_all_three_setups_on_real_images(name: str, data: Path, tmp_path: Path):
    metrics = evaluate(
        thinned(data / name, tmp_path / name, every=3),
        tmp_path / "run",
        *("--image-size", "40", "--time-budget", "2", "--tour.rounds", "6"),
    )
    assert list(metrics["setups"]) == ["oracle", "wireless", "uncertainty"]
    for setup in metrics["setups"].values():
        assert 8 < setup["psnr_db"] < 50
        assert 0 < setup["ssim"] < 1
    assert metrics["setups"]["oracle"]["camera_rms_m"] == 0
    assert 0 < metrics["setups"]["wireless"]["camera_rms_m"] < 0.5
    assert (tmp_path / "run" / "report.html").is_file()
