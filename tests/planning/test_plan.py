import numpy as np
import pytest
from PIL import Image

from mulan.errors import InputError
from mulan.mission.run_folder import RunFolder, read_json
from mulan.planning.picture import draw_plan
from mulan.planning.plan import PlanConfig, RobotView, plan_views

from .analytic_engine import BallEngine

EXACT = np.zeros((6, 6))


def test_of_two_mirrored_moves_the_one_toward_the_less_known_side_scores_higher(camera):
    from mulan.planning.candidates import look_at

    here = look_at(np.array([0.0, -2.0, 0.2]), np.zeros(3), np.array([1.0, 0.0, 0.0]))
    robot = RobotView("a", camera, here, 1e-5 * np.eye(6))
    for engine, better in ((BallEngine(variance_front=0.05), 1), (BallEngine(variance_back=0.05), -1)):
        plan = plan_views(engine, [robot], np.zeros(3), PlanConfig(columns=16)).robots[0]
        x = plan.T_world_candidate[:, 0, 3]
        assert plan.score[np.argmax(better * x)] > 1.1 * plan.score[np.argmin(better * x)]


def test_a_robot_with_nowhere_to_go_stays_and_the_picture_says_so(camera, T_world_camera, tmp_path):
    robots = [RobotView("a", camera, T_world_camera, EXACT), RobotView("b", camera, T_world_camera, EXACT)]
    plan = plan_views(BallEngine(radius_m=5.0), robots, np.zeros(3), PlanConfig(columns=8))
    assert [p.best for p in plan.robots] == [None, None]
    draw_plan(plan, BallEngine(), {}, tmp_path / "plan.png")
    assert Image.open(tmp_path / "plan.png").width > 800


def test_progress_names_each_robot_and_ends_at_the_total(camera, T_world_camera):
    seen = []
    robots = [RobotView(n, camera, T_world_camera, EXACT) for n in ("a", "b")]
    plan_views(BallEngine(), robots, np.zeros(3), PlanConfig(columns=4), lambda *report: seen.append(report))
    assert seen == [(0, 2, "a"), (1, 2, "b"), (2, 2, "done")]


def test_planning_a_run_writes_plan_json_and_a_picture(camera, tmp_path):
    nerfstudio = pytest.importorskip("mulan.mission.nerfstudio")
    from mulan.mission.posed_images import PosedImage, PosedImageSet
    from mulan.planning.candidates import look_at
    from mulan.planning.run_files import plan_run

    run = RunFolder(tmp_path)
    photos = []
    for i, angle in enumerate(np.linspace(0, 2, 6)):
        path = tmp_path / "images" / f"{i}.png"
        path.parent.mkdir(exist_ok=True)
        Image.new("RGB", (camera.width, camera.height)).save(path)
        T = look_at(2 * np.array([np.cos(angle), np.sin(angle), 0.2]), np.zeros(3), np.array([1.0, 0.0, 0.0]))
        photos.append(PosedImage(path, camera, T, 1e-4 * np.eye(6), "ab"[i % 2], float(i)))
    nerfstudio.write_transforms(PosedImageSet(tuple(photos), (), tmp_path), run.transforms)
    plan = plan_run(run, BallEngine(), PlanConfig(columns=12))
    written = read_json(run.plan, "mulan plan")
    assert list(written["robots"]) == ["a", "b"]
    np.testing.assert_allclose(written["robots"]["b"]["T_world_camera"], photos[-1].T_world_camera)
    assert written["robots"]["a"]["best"] == plan.robots[0].best
    assert len(written["robots"]["a"]["candidates"]) == len(plan.robots[0].score)
    np.testing.assert_allclose(written["centre_m"], 0, atol=0.05)
    assert (tmp_path / "plan.png").stat().st_size > 10_000


def test_a_run_without_poses_says_which_command_makes_them(tmp_path):
    pytest.importorskip("mulan.mission.nerfstudio")
    from mulan.planning.run_files import plan_run

    with pytest.raises(InputError, match=r"transforms\.json.*mulan localize"):
        plan_run(RunFolder(tmp_path), BallEngine(), PlanConfig())
