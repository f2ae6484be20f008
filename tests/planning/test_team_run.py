from dataclasses import replace

import numpy as np
import pytest

from mulan.mission.nerfstudio import write_transforms
from mulan.mission.run_folder import RunFolder, read_json
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.knowledge import LookConfig
from mulan.planning.team_plan import TeamPlanConfig
from mulan.planning.team_run import EnsembleConfig, TeamRunConfig, plan_team_run
from mulan.radiance.space import SceneSpace

from ..reconstruction.cube_scene import cube_images
from .analytic_engine import BallEngine

SPACE = SceneSpace((0.0, 0.0, 0.0), 0.9, unbounded=False)
CONFIG = TeamRunConfig(
    TeamPlanConfig(free_space=FreeSpaceConfig(places=2), refinements=1),
    EnsembleConfig(members=2, steps=3, image_size=24),
    LookConfig(6, 6),
)


@pytest.mark.parametrize("members", [0, 2])
def test_planning_for_the_team_of_a_run_writes_plan_json_and_a_picture(members, tmp_path):
    images = cube_images(tmp_path, train=4, test=1, covariance=1e-4 * np.eye(6))
    named = tuple(replace(image, robot_id="ab"[i % 2]) for i, image in enumerate(images.train))
    run = RunFolder(tmp_path / "run")
    write_transforms(replace(images, train=named), run.transforms)
    config = replace(CONFIG, ensemble=replace(CONFIG.ensemble, members=members))
    said = []
    plan = plan_team_run(run, BallEngine(), SPACE, config, lambda *report: said.append(report))
    written = read_json(run.plan, "mulan plan")
    assert list(written["robots"]) == ["a", "b"]
    assert "worth" in written["score_meaning"]
    for one in plan.robots:
        assert len(written["robots"][one.robot.robot]["candidates"]) == len(one.score) > 2
        assert written["robots"][one.robot.robot]["best"] == one.best
    goals = read_json(run.goals, "mulan plan")
    assert set(goals) == {f"/{p.robot.robot}/goal_pose" for p in plan.robots if p.best is not None}
    assert run.plan.with_suffix(".png").stat().st_size > 10_000
    assert said[-1] == (2, 2, "done")
