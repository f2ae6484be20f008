"""The next views of a whole team, chosen together by what they would teach."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from mulan.planning.candidates import CandidateConfig, free_candidates, is_free, look_at
from mulan.planning.cell_worth import CellWorth, default_ray_scores
from mulan.planning.free_space import FreeSpaceConfig, reachable_places
from mulan.planning.knowledge import Knowledge
from mulan.planning.plan import RobotPlan, RobotView, ViewPlan
from mulan.planning.pose_growth import DriftConfig, covariance_after_move
from mulan.planning.radio_fix import RadioFixConfig, Teammate, covariance_after_radio
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
    radio: RadioFixConfig = field(default_factory=RadioFixConfig)
    """What the radio will tell there about the pose."""
    team: TeamConfig = field(default_factory=TeamConfig)
    """Price of travel, and radio range."""
    headings: int = 0
    """Level views to try at each place, evenly spread; 0 looks at the scene's centre, which suits a scene
    that has one. With more, there are as many fewer places, and turning on the spot is tried too."""
    refinements: int = 2
    """How often places about the chosen ones are looked at more closely, at half the spacing each time."""


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

    A candidate's pose is as uncertain as odometry leaves it on the way, less what the radio will tell there
    of the others, who are taken to stay.

    Args:
        knowledge: Fields and views so far; several fields tell where they disagree.
        obstacles: The field that tells matter from free space.
        robots: Last camera poses with covariance.
        centre_m: Scene centre in the world, which the candidates look at.
        config: Candidates, drift and team.
        budget_m: How far each robot may still travel; without end if not given.
        progress: Called with (done, total, robot name).
    """
    if not robots:
        return ViewPlan((), centre_m, SCORE_MEANING)
    budget_m = [np.inf] * len(robots) if budget_m is None else budget_m
    worth = CellWorth(default_ray_scores(len(knowledge.fields)), knowledge)
    found = []
    for index, robot in enumerate(robots):
        if progress is not None:
            progress(index, len(robots), robot.robot)
        mates = [teammate(other) for other in robots if other is not robot]
        found.append(_Found.first(obstacles, robot, mates, centre_m, config))
    # all at once, so that one robot's mean candidate is not another's unit
    of_all = worth.of([view for one in found for view in one.views])
    ends = np.cumsum([0, *(len(one.travel_m) for one in found)])
    for one, (begin, end) in zip(found, pairwise(ends), strict=True):
        one.worth = of_all[begin:end]
    picks = _choose(found, budget_m, config)
    step_m = config.free_space.spacing_m
    for _ in range(config.refinements):
        step_m /= 2
        for one, pick in zip(found, picks, strict=True):
            if pick is not None:
                one.look_closer(pick, step_m, obstacles, centre_m, config, worth)
        picks = _choose(found, budget_m, config)
    if progress is not None:
        progress(len(robots), len(robots), "done")
    plans = [
        RobotPlan(
            one.robot, one.T_world_candidate, one.covariance, np.asarray(one.worth.sum(1), dtype=float), pick
        )
        for one, pick in zip(found, picks, strict=True)
    ]
    return ViewPlan(tuple(plans), centre_m, SCORE_MEANING)


@dataclass
class _Found:
    """What one robot could do, as far as it was looked for."""

    robot: RobotView
    mates: list[Teammate]
    T_world_candidate: Float[NDArray, "n 4 4"]
    travel_m: Float[NDArray, "n"]
    covariance: Float[NDArray, "n 6 6"]
    worth: csr_array

    @staticmethod
    def first(
        obstacles: RadianceEngine,
        robot: RobotView,
        mates: list[Teammate],
        centre_m: Float[NDArray, "3"],
        config: TeamPlanConfig,
    ) -> "_Found":
        """The free part of the ring and what is reached beyond it; not judged yet."""
        here = robot.T_world_camera[:3, 3]
        ring = free_candidates(obstacles, robot.T_world_camera, centre_m, config.candidates)
        travel_m = np.linalg.norm(ring[:, :3, 3] - here, axis=1)
        if config.headings:
            places = max(1, config.free_space.places // config.headings)
            beyond = reachable_places(obstacles, here, replace(config.free_space, places=places))
            T = _turning(np.concatenate([here[None], beyond.position_m]), config.headings)
            beyond_m = np.repeat(np.append(0.0, beyond.travel_m), config.headings)
        else:
            beyond = reachable_places(obstacles, here, config.free_space)
            T, beyond_m = _looking(robot, beyond.position_m, centre_m), beyond.travel_m
        T, travel_m = np.concatenate([ring, T]), np.concatenate([travel_m, beyond_m])
        return _Found(robot, mates, T, travel_m, _predicted(robot, mates, T, config), csr_array((0, 0)))

    @property
    def score(self) -> Float[NDArray, "n"]:
        """What each is worth by itself."""
        return np.asarray(self.worth.sum(1), dtype=float)

    @property
    def views(self) -> list[View]:
        return _views(self.robot, self.T_world_candidate, self.covariance)

    def look_closer(
        self,
        pick: int,
        step_m: float,
        obstacles: RadianceEngine,
        centre_m: Float[NDArray, "3"],
        config: TeamPlanConfig,
        worth: CellWorth,
    ) -> None:
        """Add the free places a step from a pick along the axes of its plane, or of space for who flies."""
        axes = np.eye(3) if config.free_space.in_the_air else np.eye(3)[:2]
        place = self.T_world_candidate[pick][:3, 3]
        near = place + step_m * np.concatenate([axes, -axes])
        clear = CandidateConfig(
            distance_m=step_m,
            max_density_per_m=config.free_space.max_density_per_m,
            clearance_m=config.free_space.clearance_m,
        )
        near = near[is_free(obstacles, place, near, clear)]
        T = _looking(self.robot, near, centre_m)
        if config.headings:
            T[:, :3, :3] = self.T_world_candidate[pick][:3, :3]
        covariance = _predicted(self.robot, self.mates, T, config)
        self.T_world_candidate = np.concatenate([self.T_world_candidate, T])
        self.travel_m = np.append(self.travel_m, np.full(len(T), self.travel_m[pick] + step_m))
        self.covariance = np.concatenate([self.covariance, covariance])
        self.worth = csr_array(vstack([self.worth, worth.of(_views(self.robot, T, covariance))]))


def _choose(
    found: Sequence[_Found], budget_m: Sequence[float], config: TeamPlanConfig
) -> tuple[int | None, ...]:
    # of all cells only those some candidate sees
    seen = np.unique(np.concatenate([one.worth.indices for one in found]))
    choices = [
        RobotChoices(
            one.robot.robot,
            one.robot.T_world_camera[:3, 3],
            one.T_world_candidate[:, :3, 3],
            one.travel_m,
            one.worth[:, seen].toarray(),
            float(budget),
        )
        for one, budget in zip(found, budget_m, strict=True)
    ]
    return choose_together(choices, config.team).picks


def _predicted(
    robot: RobotView, mates: list[Teammate], T: Float[NDArray, "n 4 4"], config: TeamPlanConfig
) -> Float[NDArray, "n 6 6"]:
    moved = covariance_after_move(robot.T_world_camera, robot.covariance, T, config.drift)
    return covariance_after_radio(T, moved, mates, config.radio)


def _views(robot: RobotView, T: Float[NDArray, "n 4 4"], covariance: Float[NDArray, "n 6 6"]) -> list[View]:
    return [View(robot.camera, pose, cov) for pose, cov in zip(T, covariance, strict=True)]


def _looking(
    robot: RobotView, places_m: Float[NDArray, "n 3"], centre_m: Float[NDArray, "3"]
) -> Float[NDArray, "n 4 4"]:
    right = robot.T_world_camera[:3, 0]
    return np.array([look_at(place, centre_m, right) for place in places_m]).reshape(-1, 4, 4)


def _turning(places_m: Float[NDArray, "n 3"], headings: int) -> Float[NDArray, "views 4 4"]:
    """Level views all around from each place."""
    yaw_rad = 2 * np.pi * np.arange(headings) / headings
    ahead = np.stack([np.cos(yaw_rad), np.sin(yaw_rad), np.zeros(headings)], -1)
    return np.array([look_at(p, p + a, np.array([1.0, 0.0, 0.0])) for p in places_m for a in ahead])


def teammate(robot: RobotView) -> Teammate:
    """A robot as others hear it."""
    R = robot.T_world_camera[:3, :3]
    return Teammate(robot.T_world_camera[:3, 3], R @ robot.covariance[3:, 3:] @ R.T)
