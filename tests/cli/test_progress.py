import os
import pty
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from mulan.cli import progress
from mulan.mission.nerfstudio import write_transforms
from tests.reconstruction.cube_scene import cube_images

TRAIN = "import sys; from mulan.cli.main import run_command; sys.exit(run_command(sys.argv[1:]))"


def test_without_a_terminal_a_stage_is_one_plain_line(capsys: pytest.CaptureFixture[str]):
    with progress.progress_stages() as stage:
        report = stage("Counting")
        for i in range(100):
            report(i, 100, "")
    assert capsys.readouterr().out.splitlines() == ["Counting ..."]


def test_without_a_terminal_a_long_stage_says_when_it_will_be_over(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    seconds = iter([0.0, 30.0, 31.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(seconds))
    with progress.progress_stages() as stage:
        report = stage("Counting")
        report(25, 100, "20.0 dB")
        report(26, 100, "20.1 dB")
    assert capsys.readouterr().out.splitlines() == ["Counting ...", "  Counting: 25 %, ETA 0:01:30, 20.0 dB"]


def seen_in_a_terminal(arguments: list[str], columns: int) -> str:
    """What a command prints to a terminal of that width, control sequences taken out."""
    terminal, programs_end = pty.openpty()
    environment = os.environ | {"COLUMNS": str(columns), "TERM": "xterm"}
    command = [sys.executable, "-c", TRAIN, *arguments]
    with subprocess.Popen(command, stdout=programs_end, stderr=programs_end, env=environment) as process:
        os.close(programs_end)
        printed = b""
        with suppress(OSError):  # how a terminal says on Linux that its program has ended
            while chunk := os.read(terminal, 4096):
                printed += chunk
    os.close(terminal)
    assert process.returncode == 0, printed.decode(errors="replace")
    without_colours = re.sub(r"\x1b\[[0-9;]*m", "", printed.decode(errors="replace"))
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "\n", without_colours)


@pytest.mark.skipif(sys.platform != "linux", reason="reads a pseudo-terminal the way Linux ends it")
def test_training_shows_psnr_throughput_and_time_left_in_a_terminal_of_80_columns(tmp_path: Path):
    write_transforms(cube_images(tmp_path), tmp_path / "transforms.json")
    arguments = ["train", str(tmp_path / "run"), "--data", str(tmp_path), "--image-size", "24"]
    printed = seen_in_a_terminal([*arguments, "--time-budget", "1.5"], 80)
    lines = [line for line in re.split(r"[\r\n]+", printed) if "Training" in line]
    live = [line for line in lines if re.search(r"train \d+\.\d dB, \d+\.\d+ M samples/s", line)]
    assert live, lines
    assert any(re.search(r"ETA +\d\d:\d\d", line) for line in lines), lines
    assert max(len(line) for line in lines) <= 80
    assert "Held-out views" in printed
