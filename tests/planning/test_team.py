from itertools import product

import numpy as np
import pytest

from mulan.planning.team import RobotChoices, TeamConfig, choose_alone, choose_together, gain

FREE = TeamConfig(cost_per_m=0.0)


def team(rng, robots=3, candidates=5, cells=40):
    """Robots whose candidates see a few cells each, many of them the same."""
    made = []
    for i in range(robots):
        worth = rng.uniform(0, 1, (candidates, cells)) * (rng.uniform(size=(candidates, cells)) < 0.25)
        here = rng.uniform(-3, 3, 3)
        places = here + rng.normal(0, 1, (candidates, 3))
        made.append(
            RobotChoices(str(i), here, places, np.linalg.norm(places - here, axis=1), worth, budget_m=2.5)
        )
    return made


def parts(positions, range_m):
    left, count = set(range(len(positions))), 0
    while left:
        reached = [left.pop()]
        count += 1
        while reached:
            at = reached.pop()
            near = {k for k in left if np.linalg.norm(positions[k] - positions[at]) <= range_m}
            left -= near
            reached += near
    return count


def exhaustive(robots, config):
    here = [robot.position_m for robot in robots]
    best = -np.inf
    for picks in product(*([None, *range(len(robot.travel_m))] for robot in robots)):
        taken = [(r, p) for r, p in zip(robots, picks, strict=True) if p is not None]
        if any(r.travel_m[p] > r.budget_m for r, p in taken):
            continue
        there = [r.position_m if p is None else r.places_m[p] for r, p in zip(robots, picks, strict=True)]
        if parts(there, config.radio_range_m) <= parts(here, config.radio_range_m):
            best = max(best, gain(robots, picks, config))
    return best


@pytest.mark.parametrize("config", [FREE, TeamConfig(0.5), TeamConfig(0.2, radio_range_m=4.0)])
def test_the_joint_choice_is_close_to_the_best_of_all_and_below_its_bound(config):
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(10):
        robots = team(rng, candidates=5)
        choice, best = choose_together(robots, config), exhaustive(robots, config)
        assert choice.gain == pytest.approx(gain(robots, choice.picks, config))
        assert choice.gain <= best + 1e-9 <= choice.bound + 2e-9
        ratios.append(choice.gain / best if best > 0 else 1.0)
    assert min(ratios) > 0.95
    assert np.mean(ratios) > 0.99


def test_the_joint_choice_gains_at_least_what_robots_on_their_own_do():
    rng = np.random.default_rng(1)
    won = 0
    for _ in range(30):
        robots = team(rng, candidates=8)
        together, alone = choose_together(robots, FREE).gain, gain(robots, choose_alone(robots, FREE), FREE)
        assert together >= alone - 1e-9
        won += together > alone + 1e-9
    assert won > 15


def test_two_robots_do_not_do_the_same_work():
    worth = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.5]])
    robots = [RobotChoices(name, np.zeros(3), np.zeros((2, 3)), np.zeros(2), worth) for name in "ab"]
    assert choose_alone(robots, FREE) == (0, 0)
    choice = choose_together(robots, FREE)
    assert set(choice.picks) == {0, 1}
    assert choice.gain == pytest.approx(3.5)


def test_a_robot_stays_where_no_view_is_worth_the_way_or_the_way_is_beyond_its_budget():
    worth, way = np.ones((1, 4)), np.array([3.0])
    here, there = np.zeros(3), np.array([[3.0, 0.0, 0.0]])
    assert choose_together([RobotChoices("a", here, there, way, worth)], TeamConfig(1.0)).picks == (0,)
    assert choose_together([RobotChoices("a", here, there, way, worth)], TeamConfig(2.0)).picks == (None,)
    short = RobotChoices("a", here, there, way, worth, budget_m=2.0)
    assert choose_together([short], FREE).picks == (None,)


def test_the_team_does_not_lose_a_robot_for_a_better_view():
    near, far = np.array([2.0, 0.0, 0.0]), np.array([9.0, 0.0, 0.0])
    worth = np.array([[1.0, 0.0], [0.0, 2.0]])
    going = RobotChoices("a", np.zeros(3), np.stack([near, far]), np.zeros(2), worth)
    staying = RobotChoices("b", np.zeros(3), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)))
    assert choose_together([going, staying], FREE).picks == (1, None)
    assert choose_together([going, staying], TeamConfig(0.0, radio_range_m=5.0)).picks == (0, None)
