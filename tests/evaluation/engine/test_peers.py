import sys
from pathlib import Path

import pytest

from mulan.evaluation.engine.peers import PeerConfig, PeerTask, checked_result, run_peer, why_no_peers
from mulan.evaluation.engine.scenes import EngineScene

from .fake_peer import write_runner


def scene(folder: Path) -> EngineScene:
    return EngineScene("lego_100", folder, 100, (1.0,), 2)


def run(tmp_path: Path, peer: str, *arguments: str, timeout_s: float = 60.0):
    config = PeerConfig(python=Path(sys.executable), runners=tmp_path / "peers", timeout_s=timeout_s)
    task = PeerTask(peer, arguments, scene(tmp_path), 50.0, every_nth_view=10, first_score_s=5.0)
    return run_peer(task, config, tmp_path / "out", lambda *_: None)


def test_a_runner_is_told_everything_and_its_result_comes_back(tmp_path):
    write_runner(tmp_path / "peers", "instant_ngp")
    result = run(tmp_path, "instant-ngp", "--bonus-db", "20")
    seen = result["notes"]["seen"]
    assert seen["image_size"] == "100"
    assert seen["budget_s"] == "50"
    assert seen["data"] == str(tmp_path.resolve())
    assert result["psnr_curve"] == [(5.0, 23.0), (50.0, 24.0)]
    assert result["budget_s"] == 50.0


def test_time_to_28_db_is_read_off_the_curve_whatever_the_runner_claims(tmp_path):
    write_runner(tmp_path / "peers", "fake")
    assert run(tmp_path, "fake")["seconds_to_28_db"] is None
    assert run(tmp_path, "fake", "--bonus-db", "24.5")["seconds_to_28_db"] == pytest.approx(27.5)


def test_a_runner_that_fails_says_why(tmp_path):
    write_runner(tmp_path / "peers", "broken", "raise SystemExit('no nerfstudio here')")
    assert "no nerfstudio here" in run(tmp_path, "broken")["not_run"]


def test_a_runner_that_does_not_end_is_stopped(tmp_path):
    write_runner(tmp_path / "peers", "endless", "while True: pass")
    assert "stopped after 0.5 s" in run(tmp_path, "endless", timeout_s=0.5)["not_run"]


def test_a_runner_that_writes_nothing_or_does_not_exist_is_said_not_to_have_run(tmp_path):
    write_runner(tmp_path / "peers", "silent", "")
    assert "cannot be used" in run(tmp_path, "silent")["not_run"]
    assert "no runner" in run(tmp_path, "unheard-of")["not_run"]


@pytest.mark.parametrize(
    "result",
    [
        [],
        {},
        {"psnr_curve": []},
        {"psnr_curve": [[1.0]]},
        {"psnr_curve": [[1.0, float("nan")]]},
        {"psnr_curve": [[2.0, 20.0], [1.0, 21.0]]},
        {"psnr_curve": [[1.0, "much"]]},
    ],
)
def test_a_result_without_a_sound_curve_is_refused(result):
    with pytest.raises(ValueError, match="psnr_curve"):
        checked_result(result)


def test_why_none_can_run(tmp_path):
    assert "no Python" in (why_no_peers(PeerConfig()) or "")
    assert "does not exist" in (why_no_peers(PeerConfig(python=tmp_path / "python")) or "")
    python = Path(sys.executable)
    assert "runner" in (why_no_peers(PeerConfig(python=python, runners=tmp_path / "none")) or "")
    assert why_no_peers(PeerConfig(python=python, runners=tmp_path)) is None
