import json
from collections.abc import Mapping
from typing import Any

import pytest

from mulan.cli.main import run_command
from mulan.errors import InputError
from mulan.evaluation.convergence.protocol import ConvergenceConfig, convergence, summary_of
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.run_folder import RunFolder
from mulan.radiance.kernels.native_library import find_native_library
from mulan.reconstruction.refinement.refinement_config import CoarseStage, RefinementConfig

from ...reconstruction.cube_scene import cube_images

BRIEF = RefinementConfig(
    first=CoarseStage(3, 3, 20),
    stages=(CoarseStage(1, 5, 20),),
    first_pose_steps=2,
    rays=64,
    batch_samples=2**10,
)
needs_native = pytest.mark.skipif(find_native_library()[0] is None, reason="slow without the native engine")


def attempt(ours, doubted=()) -> Mapping[str, Any]:
    figures: dict[str, Any] = {"A": {"psnr_db": 32.0}, "B": {"psnr_db": 20.0}}
    figures["ours"] = {"psnr_db": ours, "camera_median_m": 0.01, "doubted": list(doubted)}
    return figures


def test_failures_that_were_told_are_told_from_those_that_were_not():
    tried = [attempt(31.9), attempt(31.8, ["a.png"]), attempt(24.0, ["a.png", "b.png"]), attempt(22.0)]
    summary = summary_of((0.4, 7.0), tried)
    assert summary["converged"] == 0.5
    assert summary["told"] == 0.5
    assert summary["false_alarms"] == 0.5
    assert summary_of((0.4, 7.0), tried[:1])["told"] is None


@needs_native
def test_the_command_tries_every_error_and_writes_what_came_of_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mulan.evaluation.table1.ours._REFINEMENT", BRIEF)
    write_transforms(cube_images(tmp_path, train=12, test=1), tmp_path / "transforms.json")
    out = tmp_path / "out"
    arguments = ["evaluate", "convergence", "--data", str(tmp_path), "--out", str(out), "--seeds", "1"]
    assert run_command([*arguments, "--image-size", "16", "--steps", "4", "--errors", "0.2:4"]) == 0
    (error,) = json.loads((out / "metrics.json").read_text())["errors"]
    assert (error["displacement_m"], error["turn_deg"]) == (0.2, 4.0)
    assert set(error["psnr_db"]) == {"A", "B", "ours"}
    assert (out / "convergence.png").is_file()
    assert "converge" in capsys.readouterr().out


def test_what_cannot_be_tried_is_one_sentence(tmp_path):
    write_transforms(cube_images(tmp_path, train=12, test=0), tmp_path / "transforms.json")
    images = cube_images(tmp_path, train=12, test=0)
    with pytest.raises(InputError, match="test images"):
        convergence(images, ConvergenceConfig(1), RunFolder(tmp_path), lambda _: lambda *_: None, print)
    arguments = ["evaluate", "convergence", "--data", str(tmp_path), "--out", str(tmp_path / "out")]
    with pytest.raises(InputError, match=r"write them like 0\.4:7"):
        run_command([*arguments, "--errors", "0.4-7"])
