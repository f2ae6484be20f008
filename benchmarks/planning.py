"""Time to choose the next views of a team, and what choosing together gains; JSON and a picture.

python benchmarks/planning.py --out runs/planning

Each trial places robots in the furnished room, lets them photograph and measure radio on a short tour, and
plans from that: small fields learn, 8 places on the ring and 64 beyond it are judged for every robot.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from mulan.evaluation.exploration.belief import TeamBelief, believed_images
from mulan.evaluation.provenance import provenance
from mulan.localization.localize import LocalizationConfig
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.planning.cell_worth import CellWorth, default_ray_scores
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.knowledge import Knowledge
from mulan.planning.plan import RobotPlan, ViewPlan
from mulan.planning.run_files import last_views
from mulan.planning.team import RobotChoices, TeamConfig, choose_alone, choose_together, gain
from mulan.planning.team_plan import TeamPlanConfig
from mulan.planning.team_run import TEAM_LOOKS, EnsembleConfig, plan_team_images
from mulan.planning.view import View
from mulan.simulation.from_scene import SceneMissionConfig
from mulan.simulation.recording import robot_names
from mulan.simulation.team_in_world import TeamInWorld, TeamInWorldConfig
from mulan.simulation.world import World
from mulan.wireless.bearing import BearingConfig

GOAL_S = 3.0
STEP, APART = 0.024, 0.1  # of a turn about the room's middle, some 12 m: between photographs, between robots


@dataclass(frozen=True)
class Options:
    """Plan for a team several times, each from another start."""

    out: Path
    """Folder for metrics.json, planning.png and the trials' photographs."""
    robots: int = 2
    """Robots."""
    places: int = 64
    """Places of each beyond the ring."""
    photographs: int = 8
    """Of each robot before it plans."""
    trials: int = 20
    """Starts."""
    seed: int = 3000
    """Of the first trial."""


def photographed(options: Options, world: World, seed: int, run: RunFolder) -> PosedImageSet:
    """What a team knows after a short tour."""
    camera = SceneMissionConfig(width=96, height=72).camera
    rng, names = np.random.default_rng([seed, 31]), robot_names(options.robots, "--robots")
    turn, steps, first = rng.random(), STEP * np.arange(options.photographs), {}
    for index, name in enumerate(names):
        # one behind the other, so that what one will see is worth less to the next
        along = turn + APART * index + steps
        outward, upward = np.full((2, len(along)), rng.uniform(0.3, 0.7, (2, 1)))
        first[name] = world.course.cameras(along, outward, upward, np.zeros((len(along), 3)))
    starts = {name: T[0] for name, T in first.items()}
    team = TeamInWorld(world, camera, starts, TeamInWorldConfig(samples_per_pixel=8), seed)
    belief = TeamBelief(LocalizationConfig(), BearingConfig())
    belief.hear(team.tour(first))
    return believed_images(team.mission, belief.localize(team.mission), run)


def together_and_alone(plan: ViewPlan, knowledge: Knowledge, config: TeamConfig) -> dict[str, float]:
    """Gain of the joint choice among a plan's candidates, of the robots' own choices, and the bound."""
    worth = CellWorth(default_ray_scores(len(knowledge.fields)), knowledge)
    views = [_views(one) for one in plan.robots]
    of_all, begin, choices = worth.of([view for own in views for view in own]).toarray(), 0, []
    for one, own in zip(plan.robots, views, strict=True):
        here, places_m = one.robot.T_world_camera[:3, 3], one.T_world_candidate[:, :3, 3]
        travel_m = np.linalg.norm(places_m - here, axis=1)
        rows = of_all[begin : begin + len(own)]
        choices.append(RobotChoices(one.robot.robot, here, places_m, travel_m, rows))
        begin += len(own)
    joint = choose_together(choices, config)
    return {
        "joint": joint.gain,
        "alone": gain(choices, choose_alone(choices, config), config),
        "bound": joint.bound,
    }


def _views(plan: RobotPlan) -> list[View]:
    camera = plan.robot.camera
    return [View(camera, T, cov) for T, cov in zip(plan.T_world_candidate, plan.covariance, strict=True)]


def one_trial(options: Options, world: World, seed: int) -> dict[str, Any]:
    images = photographed(options, world, seed, RunFolder(options.out / f"trial_{seed}"))
    names = [robot.robot for robot in last_views(images)]
    config = TeamPlanConfig(free_space=FreeSpaceConfig(places=options.places))
    began_s, began_cpu_s = time.perf_counter(), time.process_time()
    plan, knowledge = plan_team_images(images, names, None, config, EnsembleConfig(), TEAM_LOOKS)
    wall_s, cpu_s = time.perf_counter() - began_s, time.process_time() - began_cpu_s
    return {
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "candidates": [len(one.score) for one in plan.robots],
        "gain": together_and_alone(plan, knowledge, config.team),
    }


def draw(metrics: dict[str, Any], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), dpi=120, layout="constrained")
    times, gains = figure.subplots(1, 2)
    trials = metrics["trials"]
    times.plot([one["wall_s"] for one in trials], "o", label="wall")
    times.plot([one["cpu_s"] for one in trials], "x", label="processor")
    times.axhline(GOAL_S, color="#888", lw=1, label="goal")
    times.set(xlabel="trial", ylabel="to plan [s]", ylim=(0, None))
    more = [100 * (one["gain"]["joint"] / one["gain"]["alone"] - 1) for one in trials]
    gains.bar(range(len(more)), more)
    gains.set(xlabel="trial", ylabel="joint choice above\nrobots by themselves [%]")
    times.legend()
    figure.savefig(path)


def main(options: Options) -> None:
    world = SceneMissionConfig(robots=options.robots).build()
    one_trial(options, world, options.seed + options.trials)  # loads what is loaded once
    trials = []
    for seed in range(options.seed, options.seed + options.trials):
        trials.append(one_trial(options, world, seed))
        print(seed, trials[-1], flush=True)
    metrics = {
        "robots": options.robots,
        "threads": torch.get_num_threads(),
        "wall_s": float(np.median([one["wall_s"] for one in trials])),
        "cpu_s": float(np.median([one["cpu_s"] for one in trials])),
        "joint_at_least_alone": float(
            np.mean([one["gain"]["joint"] >= one["gain"]["alone"] - 1e-9 for one in trials])
        ),
        "joint_gains": float(np.mean([one["gain"]["joint"] / one["gain"]["alone"] - 1 for one in trials])),
        "trials": trials,
        "provenance": provenance(options.seed),
    }
    write_json(options.out / "metrics.json", metrics)
    draw(metrics, options.out / "planning.png")
    print(
        f"median {metrics['wall_s']:.2f} s, {metrics['cpu_s']:.2f} s of processor; joint at least alone in "
        f"{100 * metrics['joint_at_least_alone']:.0f} % of {len(trials)} trials"
    )


if __name__ == "__main__":
    main(tyro.cli(Options))
