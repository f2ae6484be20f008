"""The next views of a whole team, chosen together by what they would teach."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.planning.candidates import CandidateConfig, free_candidates, look_at
from mulan.planning.cell_worth import cell_worth, default_ray_scores
from mulan.planning.free_space import FreeSpaceConfig, reachable_places
from mulan.planning.knowledge import Knowledge
from mulan.planning.plan import RobotPlan, RobotView, ViewPlan
from mulan.planning.pose_growth import DriftConfig, covariance_after_move
from mulan.planning.team import RobotChoices, TeamConfig, choose_together
from mulan.planning.view import View
from mulan.radiance.engine import RadianceEngine

SCORE_MEANING = "worth of a view (the mean candidate's is 1)"


@dataclass(frozen=True)
class TeamPlanConfig:
    """How a team's next views are chosen."""

    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    """The ring of views about each robot (the paper's)."""
    free_space: FreeSpaceConfig = field(default_factory=FreeSpaceConfig)
    """Further places each robot can reach."""
    drift: DriftConfig = field(default_factory=DriftConfig)
    """What odometry loses on the way."""
    team: TeamConfig = field(default_factory=TeamConfig)
    """Price of travel, and radio range."""


def plan_team(
    knowledge: Knowledge,
    obstacles: RadianceEngine,
    robots: Sequence[RobotView],
    centre_m: Float[NDArray, "3"],
    config: TeamPlanConfig,
    budget_m: Sequence[float] | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> ViewPlan:
    """Judge the ring and what can be reached beyond it, and choose one view a robot jointly.

    Args:
        knowledge: Fields and views so far; several fields tell where they disagree.
        obstacles: The field that tells matter from free space.
        robots: Last camera poses with covariance.
        centre_m: Scene centre in the world, which the candidates look at.
        config: Candidates, drift and team.
        budget_m: How far each robot may still travel; without end if not given.
        progress: Called with (done, total, robot name).
    """
    budget_m = [np.inf] * len(robots) if budget_m is None else budget_m
    poses, travel_m, covariances = [], [], []
    for index, robot in enumerate(robots):
        if progress is not None:
            progress(index, len(robots), robot.robot)
        T, way_m = _candidates(obstacles, robot, centre_m, config)
        poses.append(T)
        travel_m.append(way_m)
        covariances.append(covariance_after_move(robot.T_world_camera, robot.covariance, T, config.drift))
    views = [
        View(robot.camera, T, covariance)
        for robot, of_robot, cov in zip(robots, poses, covariances, strict=True)
        for T, covariance in zip(of_robot, cov, strict=True)
    ]
    worth = np.zeros((0, knowledge.grid.cells), np.float32)
    if views:
        worth = cell_worth(default_ray_scores(len(knowledge.fields)), knowledge, views)
    of_robots = np.split(worth, np.cumsum([len(T) for T in poses])[:-1])
    choices = [
        RobotChoices(robot.robot, robot.T_world_camera[:3, 3], T[:, :3, 3], way_m, one, float(budget))
        for robot, T, way_m, one, budget in zip(robots, poses, travel_m, of_robots, budget_m, strict=True)
    ]
    picks = choose_together(choices, config.team).picks
    if progress is not None:
        progress(len(robots), len(robots), "done")
    plans = [
        RobotPlan(robot, T, covariance, one.sum(1, dtype=float), pick)
        for robot, T, covariance, one, pick in zip(robots, poses, covariances, of_robots, picks, strict=True)
    ]
    return ViewPlan(tuple(plans), centre_m, SCORE_MEANING)


def _candidates(
    obstacles: RadianceEngine, robot: RobotView, centre_m: Float[NDArray, "3"], config: TeamPlanConfig
) -> tuple[Float[NDArray, "n 4 4"], Float[NDArray, "n"]]:
    """Poses of the free part of the ring and of what is reached beyond, with the length of the way."""
    here = robot.T_world_camera[:3, 3]
    ring = free_candidates(obstacles, robot.T_world_camera, centre_m, config.candidates)
    beyond = reachable_places(obstacles, here, config.free_space)
    right = robot.T_world_camera[:3, 0]
    there = [look_at(place, centre_m, right) for place in beyond.position_m]
    T = np.concatenate([ring, np.array(there).reshape(-1, 4, 4)])
    return T, np.concatenate([np.linalg.norm(ring[:, :3, 3] - here, axis=1), beyond.travel_m])
