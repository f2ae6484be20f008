import json
from pathlib import Path

import numpy as np
import pytest

from mulan.errors import InputError
from mulan.viewer.goals import GoalFile


def test_the_latest_goal_of_each_robot_is_kept(tmp_path: Path):
    goals = GoalFile(tmp_path / "goals.json")
    first, second = np.eye(4), np.eye(4)
    second[:3, 3] = [1, 2, 3]
    goals.accept("a", first)
    goals.accept("b", first)
    goals.accept("a", second)
    written = json.loads(goals.path.read_text())
    assert set(written) == {"a", "b"}
    assert written["a"]["T_world_camera"][1][3] == 2


def test_a_damaged_file_is_named(tmp_path: Path):
    goals = GoalFile(tmp_path / "goals.json")
    goals.path.write_text("{")
    with pytest.raises(InputError, match=r"goals\.json"):
        goals.accept("a", np.eye(4))
