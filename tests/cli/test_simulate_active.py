import importlib.util
import sys
from pathlib import Path

import pytest

from mulan.cli import simulate
from mulan.cli.simulate_active import film_frames
from mulan.errors import InputError
from mulan.mission.bag_reader import read_mission
from mulan.mission.run_folder import RunFolder, read_json

from ..evaluation.exploration.test_explore import XML

WITH_VIDEO = importlib.util.find_spec("imageio_ffmpeg") is not None


def test_one_command_goes_from_the_first_photograph_to_the_report_and_the_video(tmp_path: Path):
    scene, out = tmp_path / "block.xml", tmp_path / "run"
    scene.write_text(XML)
    words = (
        f"--active --out {out} --scene {scene} --robots 2 --steps 1 --first-photos 3 --width 24 --height 18"
    )
    words += f" --samples-per-pixel 1 --held-out 1 --time-budget 0.5 --frames {2 if WITH_VIDEO else 0}"
    words += " --free-space.places 4 --ensemble.members 2 --ensemble.steps 3 --lose beta@1"
    assert simulate.main(words.split()) == 0
    run = RunFolder(out)
    steps = read_json(run.root / "steps.json", "test")["steps"]
    assert [step["lost"] for step in steps] == ["beta"]
    assert run.report.stat().st_size > 10_000
    if WITH_VIDEO:
        assert (run.root / "video.mp4").stat().st_size > 500
    mission = read_mission(run.root / "mission.mcap")
    assert [len(robot.photos) for robot in mission.robots] in ([4, 3], [3, 3])


def test_without_ffmpeg_only_a_video_that_was_asked_for_stops_a_mission(monkeypatch: pytest.MonkeyPatch):
    if WITH_VIDEO:
        assert film_frames(None) > 0
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert film_frames(None) == film_frames(0) == 0
    with pytest.raises(InputError, match=r"imageio-ffmpeg.*mulan\[export\]"):
        film_frames(8)


@pytest.mark.parametrize("word", ["beta", "beta@", "beta@0", "@3x"])
def test_a_loss_that_names_no_robot_and_step_is_refused(word: str, tmp_path: Path):
    with pytest.raises(InputError, match="ROBOT@STEP"):
        simulate.main(["--active", "--out", str(tmp_path), "--lose", word])
