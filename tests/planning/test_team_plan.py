from dataclasses import replace

import numpy as np
import pytest

from mulan.planning.cell_worth import CellWorth
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.plan import RobotView
from mulan.planning.scores.angular_novelty import AngularNovelty
from mulan.planning.scores.coverage import Coverage
from mulan.planning.team import TeamConfig
from mulan.planning.team_plan import TeamPlanConfig, plan_team
from mulan.planning.view import View
from mulan.planning.ways import worth_of_ways

from .analytic_engine import BallEngine
from .test_scores import CAMERA, MEMBERS, knowing, view

EXACT = np.zeros((6, 6))


def robot(name, azimuth_deg, distance_m=1.6):
    return RobotView(name, CAMERA, view(azimuth_deg, distance_m=distance_m).T_world_camera, 1e-6 * np.eye(6))


def test_the_mean_candidate_is_worth_one_and_worth_lies_where_it_is_seen():
    candidates = [view(a) for a in (20, 100, 180)]
    knowledge = knowing(view(0), fields=MEMBERS)
    judge = CellWorth((AngularNovelty(), Coverage()), knowledge)
    worth = judge.of(candidates).toarray()
    assert worth.sum(1).mean() == pytest.approx(1, rel=1e-5)
    assert (np.diff(worth.sum(1)) > 0).all()
    for candidate, of_cell in zip(candidates, worth, strict=True):
        assert set(np.flatnonzero(of_cell)) <= set(knowledge.look(candidate).cell.tolist())
    np.testing.assert_allclose(judge.of(candidates[:1]).toarray()[0], worth[0])  # the units stay


def test_two_robots_side_by_side_go_apart():
    chosen = [View(CAMERA, r.T_world_camera, EXACT) for r in (robot("a", 0), robot("b", 4))]
    config = TeamPlanConfig(free_space=FreeSpaceConfig(places=16), team=TeamConfig(0.0))
    knowledge = knowing(*chosen, fields=MEMBERS)
    plan = plan_team(knowledge, BallEngine(), [robot("a", 0), robot("b", 4)], np.zeros(3), config)
    a, b = (p.T_world_candidate[p.best][:3, 3] for p in plan.robots)
    together, each = (
        np.linalg.norm(a - b),
        [np.linalg.norm(p.T_world_candidate[np.argmax(p.score)][:3, 3]) for p in plan.robots],
    )
    assert together > 1.0
    assert all(distance > 0.5 for distance in each)


def test_a_robot_without_budget_stays_and_one_walled_in_too():
    config = TeamPlanConfig(free_space=FreeSpaceConfig(places=10))
    knowledge = knowing(view(0))
    pair = [robot("a", 0), robot("b", 90)]
    plan = plan_team(knowledge, BallEngine(), pair, np.zeros(3), config, budget_m=[0.0, 5.0])
    assert plan.robots[0].best is None
    assert plan.robots[1].best is not None
    walled = plan_team(knowledge, BallEngine(radius_m=5.0), pair, np.zeros(3), config)
    assert [p.best for p in walled.robots] == [None, None]


def test_costly_travel_keeps_robots_near():
    far, near = (
        plan_team(
            knowing(view(0)),
            BallEngine(),
            [robot("a", 0)],
            np.zeros(3),
            TeamPlanConfig(free_space=FreeSpaceConfig(places=16), team=TeamConfig(cost)),
        ).robots[0]
        for cost in (0.0, 1.0)
    )
    here = robot("a", 0).T_world_camera[:3, 3]
    assert far.best is not None
    moved = [
        0.0 if p.best is None else np.linalg.norm(p.T_world_candidate[p.best][:3, 3] - here)
        for p in (far, near)
    ]
    assert moved[1] < moved[0]


def test_a_closer_look_never_loses_worth():
    plain, refined = (
        plan_team(
            knowing(view(0), fields=MEMBERS),
            BallEngine(),
            [robot("a", 0)],
            np.zeros(3),
            replace(
                TeamPlanConfig(free_space=FreeSpaceConfig(places=10), team=TeamConfig(0.0)), refinements=n
            ),
        ).robots[0]
        for n in (0, 3)
    )
    assert len(refined.score) > len(plain.score)
    assert refined.score[refined.best] >= plain.score[plain.best] - 1e-6


def test_with_headings_a_robot_also_turns_on_the_spot():
    config = TeamPlanConfig(free_space=FreeSpaceConfig(places=8), headings=4, refinements=1)
    one = robot("a", 0)
    plan = plan_team(knowing(view(0), fields=MEMBERS), BallEngine(), [one], np.zeros(3), config).robots[0]
    here = one.T_world_camera[:3, 3]
    still = np.linalg.norm(plan.T_world_candidate[:, :3, 3] - here, axis=1) < 1e-9
    assert still.sum() == 4
    np.testing.assert_allclose(plan.T_world_candidate[still][:, 2, 1], 1, atol=1e-9)  # level
    ahead = -plan.T_world_candidate[still][:, :2, 2]
    np.testing.assert_allclose(ahead @ ahead[0], [1, 0, -1, 0], atol=1e-9)


def test_a_way_counts_every_cell_once_and_is_worth_at_least_its_best_view():
    knowledge, scores = knowing(view(0), fields=MEMBERS), (AngularNovelty(),)
    near, far = view(40), view(80)
    alone = worth_of_ways(knowledge, [[near], [far], [near, far], [far, far]], scores)
    assert alone[2] >= alone[:2].max()
    assert alone[3] == pytest.approx(alone[1])
    assert alone[2] < alone[0] + alone[1]
