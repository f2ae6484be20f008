from pathlib import Path

import pytest

from mulan.cli.main import run_command


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two robots in the rendered room, small enough for a test."""
    path = tmp_path_factory.mktemp("bag") / "room.mcap"
    arguments = ["simulate", "-o", str(path), "--robots", "2", "--photos-per-robot", "10"]
    sizes = ["--width", "48", "--height", "36", "--samples-per-pixel", "4", "--tour.rounds", "4"]
    assert run_command([*arguments, *sizes]) == 0
    return path


@pytest.fixture(scope="session")
def finished_run(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole loop on the bag."""
    folder = tmp_path_factory.mktemp("runs") / "room"
    sizes = ["--train.image-size", "48", "--train.steps", "300", "--plan-columns", "6"]
    assert run_command(["run", str(bag), "--out", str(folder), *sizes]) == 0
    return folder
