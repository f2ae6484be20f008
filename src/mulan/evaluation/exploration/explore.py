"""The closed loop: what was learnt says where to go, until the budget ends."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.evaluation.exploration.belief import TeamBelief, believed_images
from mulan.geometry import se3
from mulan.localization.localize import LocalizationConfig
from mulan.localization.types import Localization
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.planning.knowledge import LookConfig
from mulan.planning.plan import RobotPlan, ViewPlan
from mulan.planning.team_plan import TeamPlanConfig
from mulan.planning.team_run import TEAM_LOOKS, EnsembleConfig, plan_team_images
from mulan.simulation.from_scene import SceneMissionConfig, held_out_cameras, robot_cameras
from mulan.simulation.recording import T_BODY_CAMERA, robot_names
from mulan.simulation.team_in_world import TeamInWorld, TeamInWorldConfig
from mulan.wireless.bearing import BearingConfig

_HEADINGS = 8  # tried at each place where a world has no centre to look at

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


@dataclass(frozen=True)
class Loss:
    """A robot that stops answering.

    Attributes:
        robot: Name.
        step: From this step on, counted from 1; what it sent before is kept.
    """

    robot: str
    step: int


@dataclass(frozen=True)
class ExplorationConfig:
    """A mission whose robots choose their own views."""

    scene: SceneMissionConfig = field(default_factory=lambda: SceneMissionConfig(width=128, height=96))
    """The world, the lens, the test views and the number of robots."""
    first_photos: int = 4
    """Photographs of each robot before the first choice, close together at the start of its share."""
    first_share: float = 0.35
    """Part of its share of the course a robot passes for them."""
    steps: int = 8
    """Most choices."""
    budget_m: float = 8.0
    """How far each robot may travel after its first photographs."""
    lose: Loss | None = None
    """A robot that stops answering."""
    team: TeamInWorldConfig = field(default_factory=TeamInWorldConfig)
    """What the robots are."""
    plan: TeamPlanConfig = field(default_factory=TeamPlanConfig)
    """How the next views are chosen."""
    ensemble: EnsembleConfig = field(default_factory=EnsembleConfig)
    """The small fields that plan."""
    looks: LookConfig = TEAM_LOOKS
    """Rays of a look."""
    graph: LocalizationConfig = field(default_factory=LocalizationConfig)
    """Factor graph."""
    bearings: BearingConfig = field(default_factory=BearingConfig)
    """Radio bearings."""


class Exploration:
    """One mission; :meth:`run` is the loop.

    Attributes:
        config: Options.
        team: The robots in their world.
        left_m: How far each may still travel.
        history: What each step did, as steps.json has it.
    """

    def __init__(self, config: ExplorationConfig, run: RunFolder) -> None:
        """Build the world and place the robots.

        Args:
            config: Options.
            run: Photographs and steps.json go here.

        Raises:
            InputError: An option makes no sense, or the scene file cannot be used.
        """
        names = robot_names(config.scene.robots, "--robots")
        if config.lose is not None and config.lose.robot not in names:
            problem = f"robot '{config.lose.robot}' takes no part"
            raise InputError("--lose", "value", problem, f"choose from {', '.join(names)}")
        if config.first_photos < 2:
            raise InputError("--first-photos", "value", "is below 2", "give 2 or more")
        self.config, self._run = config, run
        self._first = first_cameras(config)
        starts = {name: T[0] for name, T in self._first.items()}
        scene = config.scene
        self.team = TeamInWorld(scene.build(), scene.camera, starts, config.team, scene.seed)
        self._plan = config.plan
        if not scene.course.has_centre and not self._plan.headings:
            ring = replace(self._plan.candidates, look_at_centre=False)
            self._plan = replace(self._plan, candidates=ring, headings=_HEADINGS)
        self._belief = TeamBelief(config.graph, config.bearings)
        self.left_m = dict.fromkeys(names, config.budget_m)
        self.history: list[dict[str, Any]] = []

    def run(self, progress: Progress) -> tuple[Localization, PosedImageSet]:
        """Photograph a little, then move, photograph, measure, localize, learn and plan to the end.

        Returns:
            Where all photographs were taken, as the team believes; and the photographs with these poses.

        Raises:
            CollisionError: A robot would run into something; it never does.
        """
        total = self.config.steps + 1
        progress(0, total, "first photographs")
        if self.config.scene.held_out > 0:
            self.team.hold_out(held_out_cameras(self.config.scene))
        self._belief.hear(self.team.tour(self._first))
        for step in range(1, self.config.steps + 1):
            progress(step, total, f"step {step}")
            if not self._step(step):
                break
        progress(total, total, "done")
        return self._look_back()

    def _step(self, step: int) -> bool:
        """One round of the loop; whether anybody moved."""
        lost = self._lost(step)
        localization, images = self._look_back()
        photographed = {image.robot_id for image in images.train}
        active = [name for name in self.left_m if name in photographed and name != lost]
        plan, _ = plan_team_images(
            images,
            active,
            [self.left_m[name] for name in active],
            self._plan,
            self.config.ensemble,
            self.config.looks,
        )
        goals = self._agreed(plan)
        moved = {name: goal for name, goal in goals.items() if goal is not None}
        # a robot without goal, or that could not be placed yet, stays and measures
        others = [name for name in self.left_m if name not in goals and name != lost]
        before = {name: self.team.T_world_body[name][:3, 3] for name in self.left_m}
        if moved:
            self._belief.hear(self.team.go(goals | dict.fromkeys(others)))
        travelled_m = {
            name: float(np.linalg.norm(self.team.T_world_body[name][:3, 3] - before[name])) for name in before
        }
        for name, length_m in travelled_m.items():
            self.left_m[name] -= length_m
        self.history.append(
            {
                "step": step,
                "lost": lost,
                "photographs": len(images.train),
                "undetermined": [robot.robot for robot in localization.undetermined],
                "robots": {
                    robot.robot.robot: {
                        "candidates": len(robot.score),
                        "position_sigma_m": float(np.sqrt(np.trace(robot.robot.covariance[3:, 3:]) / 3)),
                        "moved_m": travelled_m[robot.robot.robot],
                        "left_m": self.left_m[robot.robot.robot],
                    }
                    for robot in plan.robots
                },
            }
        )
        write_json(self._run.root / "steps.json", {"steps": self.history})
        return bool(moved)

    def _lost(self, step: int) -> str | None:
        lose = self.config.lose
        return lose.robot if lose is not None and step >= lose.step else None

    def _look_back(self) -> tuple[Localization, PosedImageSet]:
        mission = self.team.mission
        localization = self._belief.localize(mission)
        return localization, believed_images(mission, localization, self._run)

    def _agreed(self, plan: ViewPlan) -> dict[str, Float[NDArray, "4 4"] | None]:
        """True goal of each robot: its best view that its own sensors let it drive to."""
        goals: dict[str, Float[NDArray, "4 4"] | None] = {}
        for robot in plan.robots:
            goals[robot.robot.robot] = self._drivable(robot, goals)
        return goals

    def _drivable(
        self, plan: RobotPlan, others: Mapping[str, Float[NDArray, "4 4"] | None]
    ) -> Float[NDArray, "4 4"] | None:
        if plan.best is None:
            return None
        name = plan.robot.robot
        # a goal is driven to by odometry, from where the robot believes to be
        T_true_believed = (
            self.team.T_world_body[name] @ T_BODY_CAMERA @ se3.inverse(plan.robot.T_world_camera)
        )
        order = [plan.best, *(int(k) for k in np.argsort(-plan.score) if k != plan.best)]
        for k in order:
            candidate = plan.T_world_candidate[k]
            if np.linalg.norm(candidate[:3, 3] - plan.robot.T_world_camera[:3, 3]) > self.left_m[name]:
                continue
            goal = T_true_believed @ candidate
            if self.team.can_go(name, goal, others):
                return goal
        return None


def first_cameras(config: ExplorationConfig) -> dict[str, Float[NDArray, "n 4 4"]]:
    """Camera poses of each robot before it chooses: the beginning of what it would tour by itself."""
    count = max(config.first_photos, round((config.first_photos - 1) / config.first_share) + 1)
    scene = replace(config.scene, photos_per_robot=count)
    names = robot_names(scene.robots, "--robots")
    return {name: robot_cameras(scene, i)[: config.first_photos] for i, name in enumerate(names)}
