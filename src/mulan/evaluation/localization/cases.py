"""The simulated cases: pairs with exact odometry, with outliers, with drift, and fleets."""

import multiprocessing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from mulan.evaluation.localization.simulated_team import Case, Noise
from mulan.evaluation.localization.trials import Trial, run_trial, summed_up

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class CasesConfig:
    """Size of the simulation."""

    trials: int = 200
    """Teams drawn of every case of two robots."""
    meetings: tuple[int, ...] = (1, 2, 5, 20, 100)
    """Places at which two robots measure each other."""
    fleets: tuple[int, ...] = (3, 5, 10, 20, 50)
    """Robots in a fleet; each pair in reach measures at five places."""
    fleet_robot_trials: int = 240
    """Fleets drawn of a size: so many divided by the number of robots, but at least four."""
    seed: int = 0
    """Source of all randomness."""
    workers: int = 2
    """Processes, one thread each."""
    noise: Noise = field(default_factory=Noise)
    """What is added to the truth."""


def cases_of(config: CasesConfig) -> list[Case]:
    """Every case, in the order of the results."""
    trials = config.trials
    cases = [Case(f"pairs_{m}", trials, meetings=m) for m in config.meetings]
    cases += [Case(f"outliers_{m}", trials, meetings=m, outlier_share=0.2) for m in config.meetings]
    cases += [Case(f"drift_{m}", trials, meetings=m, drifting=True) for m in config.meetings]
    for drifting, suffix in ((False, ""), (True, "_drift")):
        for n in config.fleets:
            count = min(trials, max(4, config.fleet_robot_trials // n))
            cases.append(Case(f"robots_{n}{suffix}", count, robots=n, drifting=drifting, samples=41))
    return cases


def finished_cases(
    config: CasesConfig, known: Collection[str], progress: Progress
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and line of ``metrics.json`` of every case not known yet, as each is finished."""
    cases = [case for case in cases_of(config) if case.name not in known]
    # the shortest first: a run that is stopped has most of its cases
    cases.sort(key=lambda case: case.robots**2 * case.meetings)
    jobs = [(case, index) for case in cases for index in range(case.trials)]
    trials: list[Trial] = []
    for done, ((case, _), trial) in enumerate(_run(jobs, config)):
        trials.append(trial)
        progress(done + 1, len(jobs), case.name)
        if len(trials) == case.trials:
            yield case.name, summed_up(case, trials)
            trials = []


def _one(job: tuple[Case, int], noise: Noise, seed: int) -> Trial:
    return run_trial(job[0], noise, seed, job[1])


def _run(jobs: Sequence[tuple[Case, int]], config: CasesConfig) -> Iterator[tuple[tuple[Case, int], Trial]]:
    work = partial(_one, noise=config.noise, seed=config.seed)
    if config.workers <= 1:
        yield from zip(jobs, map(work, jobs), strict=True)
        return
    # a fresh interpreter each: a fork would copy locks held by threads of the parent
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(config.workers, mp_context=context) as pool:
        yield from zip(jobs, pool.map(work, jobs), strict=True)


@dataclass(frozen=True)
class Goal:
    """One line of the goals: a figure of a case and what it should be.

    Attributes:
        figure: Key in the case.
        low, high: Allowed.
        cases: First part of the names it holds for.
        least_meetings: Cases with fewer are not judged.
    """

    figure: str
    low: float
    high: float
    cases: str
    least_meetings: int = 1


GOALS = (
    Goal("rms_over_bound", 0.0, 1.15, "pairs", 5),
    Goal("nees_per_dof", 0.80, 1.25, "pairs", 5),
    Goal("rms_over_bound", 0.0, 1.30, "outliers", 5),
    Goal("nees_per_dof", 0.0, 1.60, "outliers", 5),
    Goal("nees_per_dof", 0.80, 1.30, "drift"),
    Goal("rms_over_bound", 0.0, 1.15, "robots"),
    Goal("nees_per_dof", 0.80, 1.30, "robots"),
)


def judged(cases: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Whether each goal is met: ``pass`` or ``short``, with what was measured in every case it holds for."""
    result = {}
    for goal in GOALS:
        measured = {
            name: case[goal.figure]
            for name, case in cases.items()
            if name.startswith(goal.cases + "_") and case["meetings"] >= goal.least_meetings
        }
        if not measured:
            continue
        met = all(value is not None and goal.low <= value <= goal.high for value in measured.values())
        asked = f"{goal.cases}: {goal.figure} {goal.low:g} to {goal.high:g}"
        if goal.least_meetings > 1:
            asked += f" from {goal.least_meetings} meetings on"
        result[asked] = {"result": "pass" if met else "short", "measured": measured}
    return result
