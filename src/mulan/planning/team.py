"""Which robot takes which view, so that no two do the same work and the team stays in touch."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

PROMISING = 6  # candidates of a robot that are tried together with those of another


@dataclass(frozen=True)
class TeamConfig:
    """What a team weighs against what it would learn."""

    cost_per_m: float = 0.05
    """Worth of a metre saved, in the worth of an average candidate."""
    radio_range_m: float = math.inf
    """Robots farther apart cannot measure or talk to each other; a choice must not split the team."""


@dataclass(frozen=True)
class RobotChoices:
    """What one robot could do.

    Attributes:
        robot: Name.
        position_m: Where it is.
        places_m: Where each candidate is.
        travel_m: Length of the way there.
        worth: What each candidate would add to each cell of the scene.
        budget_m: How far it may still travel.
    """

    robot: str
    position_m: Float[NDArray, "3"]
    places_m: Float[NDArray, "n 3"]
    travel_m: Float[NDArray, "n"]
    worth: Float[NDArray, "n cells"]
    budget_m: float = math.inf


@dataclass(frozen=True)
class TeamChoice:
    """What the team should do.

    Attributes:
        picks: Candidate of each robot, None where it stays.
        gain: Worth of the choice, each cell counted once, less the travel.
        bound: No choice within the budgets gains more.
    """

    picks: tuple[int | None, ...]
    gain: float
    bound: float


def choose_together(robots: Sequence[RobotChoices], config: TeamConfig) -> TeamChoice:
    """One candidate a robot, or none, chosen jointly.

    A cell seen by several robots counts once, by the best of them (facility location, which is submodular).
    Greedy over robots and candidates, then one or two robots at a time as long as the team gains; also begun
    from what each robot would do by itself, so that it is never worse than that where that keeps the team in
    touch.
    """
    begun = [_greedy(robots, config)]
    alone = choose_alone(robots, config)
    if _in_touch(robots, alone, config):
        begun.append(list(alone))
    picks = max((_improved(robots, start, config) for start in begun), key=lambda p: gain(robots, p, config))
    return TeamChoice(tuple(picks), gain(robots, picks, config), _bound(robots, picks, config))


def choose_alone(robots: Sequence[RobotChoices], config: TeamConfig) -> tuple[int | None, ...]:
    """What each robot would choose if it knew of no other."""
    nothing = np.zeros(robots[0].worth.shape[1]) if robots else np.zeros(0)
    return tuple(_best(robot, nothing, config)[0] for robot in robots)


def gain(robots: Sequence[RobotChoices], picks: Sequence[int | None], config: TeamConfig) -> float:
    """Worth of a choice, each cell counted once, less the travel."""
    travel_m = sum(r.travel_m[p] for r, p in zip(robots, picks, strict=True) if p is not None)
    return float(_seen(robots, picks).sum() - config.cost_per_m * travel_m)


def _seen(robots: Sequence[RobotChoices], picks: Sequence[int | None]) -> Float[NDArray, "cells"]:
    """What the picks add to each cell."""
    best = np.zeros(robots[0].worth.shape[1]) if robots else np.zeros(0)
    for robot, pick in zip(robots, picks, strict=True):
        if pick is not None:
            best = np.maximum(best, robot.worth[pick])
    return best


def _net(robot: RobotChoices, seen: Float[NDArray, "cells"], config: TeamConfig) -> Float[NDArray, "n"]:
    """What each candidate would add to what others see, less its travel; -inf beyond the budget."""
    more = np.clip(robot.worth - seen, 0, None).sum(1) - config.cost_per_m * robot.travel_m
    return np.where(robot.travel_m <= robot.budget_m, more, -np.inf)


def _best(
    robot: RobotChoices,
    seen: Float[NDArray, "cells"],
    config: TeamConfig,
    allowed: Sequence[bool] | None = None,
) -> tuple[int | None, float]:
    net = _net(robot, seen, config)
    if allowed is not None:
        net = np.where(allowed, net, -np.inf)
    if not len(net) or net.max() <= 0:
        return None, 0.0
    return int(np.argmax(net)), float(net.max())


def _greedy(robots: Sequence[RobotChoices], config: TeamConfig) -> list[int | None]:
    picks: list[int | None] = [None] * len(robots)
    undecided = set(range(len(robots)))
    while undecided:
        seen, found = _seen(robots, picks), {}
        for i in sorted(undecided):
            found[i] = _best(robots[i], seen, config, _allowed(robots, picks, i, config))
        best = max(found, key=lambda i: found[i][1])
        if found[best][0] is None:
            break
        picks[best] = found[best][0]
        undecided.remove(best)
    return picks


def _improved(
    robots: Sequence[RobotChoices], picks: Sequence[int | None], config: TeamConfig
) -> list[int | None]:
    """Each robot in turn takes what is best given the others, then two at once, until nobody changes."""
    picks, now = list(picks), gain(robots, picks, config)
    changed = True
    while changed:
        changed = False
        for i in range(len(robots)):
            others = [None if k == i else pick for k, pick in enumerate(picks)]
            allowed = _allowed(robots, picks, i, config)
            pick, _ = _best(robots[i], _seen(robots, others), config, allowed)
            tried = [*picks[:i], pick, *picks[i + 1 :]]
            if pick is None and not _in_touch(robots, tried, config):
                continue
            if (value := gain(robots, tried, config)) > now + 1e-9:
                picks, now, changed = tried, value, True
        if not changed:
            tried = _two_at_once(robots, picks, config)
            if (value := gain(robots, tried, config)) > now + 1e-9:
                picks, now, changed = tried, value, True
    return picks


def _two_at_once(
    robots: Sequence[RobotChoices], picks: list[int | None], config: TeamConfig
) -> list[int | None]:
    """The best exchange of two robots' picks for promising ones, which may only together stay in touch."""
    best, most = picks, gain(robots, picks, config)
    for i, k in combinations(range(len(robots)), 2):
        others = [None if j in (i, k) else pick for j, pick in enumerate(picks)]
        seen = _seen(robots, others)
        promising = []
        for j in (i, k):
            net = _net(robots[j], seen, config)
            order = np.argsort(-net)[:PROMISING]
            promising.append([None, *(int(p) for p in order if np.isfinite(net[p]))])
        for of_i, of_k in product(*promising):
            tried = list(others)
            tried[i], tried[k] = of_i, of_k
            if (value := gain(robots, tried, config)) > most and _in_touch(robots, tried, config):
                best, most = tried, value
    return best


def _allowed(
    robots: Sequence[RobotChoices], picks: Sequence[int | None], robot: int, config: TeamConfig
) -> list[bool]:
    """Which candidates of a robot keep the team in touch while the others do as picked."""
    count = len(robots[robot].travel_m)
    if math.isinf(config.radio_range_m):
        return [True] * count
    return [_in_touch(robots, [*picks[:robot], pick, *picks[robot + 1 :]], config) for pick in range(count)]


def _in_touch(robots: Sequence[RobotChoices], picks: Sequence[int | None], config: TeamConfig) -> bool:
    """Whether the team has no more separate parts than now."""
    if math.isinf(config.radio_range_m) or len(robots) < 2:
        return True
    here = np.stack([robot.position_m for robot in robots])
    there = np.stack(
        [r.position_m if p is None else r.places_m[p] for r, p in zip(robots, picks, strict=True)]
    )
    return _parts(there, config.radio_range_m) <= _parts(here, config.radio_range_m)


def _parts(position_m: Float[NDArray, "n 3"], range_m: float) -> int:
    apart = np.linalg.norm(position_m[:, None] - position_m, axis=-1)
    return int(connected_components(apart <= range_m, directed=False)[0])


def _bound(robots: Sequence[RobotChoices], picks: Sequence[int | None], config: TeamConfig) -> float:
    """``f(S) + Σ max Δ(c|S)``: what is seen, and the most each robot could add to it (Minoux 1978)."""
    seen = _seen(robots, picks)
    return float(seen.sum()) + sum(_best(robot, seen, config)[1] for robot in robots)
