from pathlib import Path

import pytest
import tyro

from mulan.cli import run as run_command
from mulan.cli import train as train_command


@pytest.mark.parametrize("spelling", ["--time-budget", "--time-budget-s"])
def test_both_spellings_of_the_training_budget(spelling: str):
    options = tyro.cli(train_command.Options, args=["runs/a", spelling, "7.5"])
    assert options.config.time_budget_s == 7.5


def test_run_passes_the_training_budget_on():
    options = tyro.cli(
        run_command.Options, args=["a.mcap", "--out", str(Path("runs/a")), "--train.time-budget", "9"]
    )
    assert options.train.time_budget_s == 9
