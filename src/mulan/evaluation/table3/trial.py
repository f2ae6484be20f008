"""One policy on one seed: four times each robot takes one of eight moves, photographs, and is judged."""

import hashlib
import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.exploration.belief import TeamBelief, believed_images
from mulan.evaluation.table3.moves import MoveConfig, choose_moves
from mulan.evaluation.table3.policies import Policy
from mulan.evaluation.view_selection.judgement import judge
from mulan.localization.accuracy import accuracy
from mulan.localization.localize import LocalizationConfig
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.planning.run_files import last_views
from mulan.radiance.backend import Device
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.field_choice import choose_march
from mulan.reconstruction.learn_in_memory import learn_in_memory
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import UncertaintyWeights
from mulan.simulation.course import Course
from mulan.simulation.from_scene import SceneMissionConfig, held_out_cameras
from mulan.simulation.recording import robot_names
from mulan.simulation.team_in_world import TeamInWorld, TeamInWorldConfig
from mulan.simulation.world import World
from mulan.wireless.bearing import BearingConfig

# no photograph is left out for its pose: with a handful, every one is needed, and rules would differ by that
_WEIGHTS = UncertaintyWeights(most_sigma_px=math.inf)
_RAY_STEPS = 128  # half of what a long training takes; as good in a short one, in less time

OBSERVATIONS = (1, 2, 3, 4)
"""Photographs each robot adds, at each of which the field is learnt anew and judged."""


@dataclass(frozen=True)
class TrialConfig:
    """The schedule: eight directions, half a metre, four observations (paper, Active Image Capturing)."""

    scene: SceneMissionConfig = field(
        default_factory=lambda: SceneMissionConfig(robots=2, width=96, height=72, held_out=16)
    )
    """The furnished room, the lens, the test views and the number of robots."""
    first_photos: int = 3
    """Photographs of each robot before the first choice."""
    first_step_m: float = 0.3
    """Distance between them."""
    team: TeamInWorldConfig = field(default_factory=TeamInWorldConfig)
    """What the robots are."""
    moves: MoveConfig = field(default_factory=MoveConfig)
    """Eight moves of half a metre, and what is known when one is chosen."""
    steps: int = 600
    """Optimiser steps of the fields that are judged."""
    batch_samples: int = 8192
    """Field evaluations a step of theirs."""


class Start:
    """What all policies of a seed share: the world, the first photographs, and where the scene is.

    Attributes:
        team: Robots after their first photographs.
        belief: What their radios said.
        config: The schedule.
        seed: Source of all randomness.
    """

    def __init__(self, world: World, seed: int, config: TrialConfig) -> None:
        self.seed, self.config, self._world = seed, config, world

    @cached_property
    def _begun(self) -> tuple[TeamInWorld, TeamBelief]:
        config = self.config
        scene = replace(config.scene, seed=self.seed)
        first = first_cameras(config, self._world.course, self.seed)
        starts = {name: T[0] for name, T in first.items()}
        team = TeamInWorld(self._world, scene.camera, starts, config.team, self.seed)
        team.hold_out(held_out_cameras(scene))
        belief = TeamBelief(LocalizationConfig(), BearingConfig())
        belief.hear(team.tour(first))
        return team, belief

    def branch(self) -> tuple[TeamInWorld, TeamBelief]:
        """The team after its first photographs, to go on with."""
        team, belief = self._begun
        return team.branch(), belief.branch()

    def space(self, images: PosedImageSet) -> SceneSpace:
        """Where the scene is, from the first photographs of each robot, the same for all policies."""
        first = [
            [image for image in images.train if image.robot_id == name][: self.config.first_photos]
            for name in robot_names(self.config.scene.robots, "table3")
        ]
        return choose_space(load_captured([image for own in first for image in own], 32))


def first_cameras(config: TrialConfig, course: Course, seed: int) -> dict[str, Float[NDArray, "n 4 4"]]:
    """Where each robot photographs before it chooses: a short arc, somewhere on the course."""
    rng = np.random.default_rng([seed, 21])
    names = robot_names(config.scene.robots, "table3")
    first = {}
    turn = rng.random()
    for index, name in enumerate(names):
        # about the middle of the ring, where a turn is some 12 m long
        step = config.first_step_m / 12.5
        along = turn + (index + rng.uniform(-0.15, 0.15)) / len(names) + step * np.arange(config.first_photos)
        n = len(along)
        outward, upward = np.full(n, rng.uniform(0.3, 0.7)), np.full(n, rng.uniform(0.3, 0.7))
        first[name] = course.cameras(along, outward, upward, np.zeros((n, 3)))
    return first


def made_from(policy: Policy, start: Start) -> str:
    """A digest of everything a trial's figures depend on."""
    text = f"{policy.rule(start.seed)} {start.seed} {start.config}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def finished_trial(digest: str, policy: Policy, run: RunFolder) -> dict[str, Any] | None:
    """Figures of a trial finished earlier from the same, or None."""
    path = run.root / f"{policy.name}.json"
    if not path.exists():
        return None
    figures = read_json(path, "mulan evaluate table3")
    return figures if figures.get("made_from") == digest else None


def run_trial(policy: Policy, start: Start, digest: str, run: RunFolder) -> dict[str, Any]:
    """Move, photograph, measure, localize, learn, judge, choose: four times.

    Returns:
        What it writes to ``<policy>.json`` in the seed's folder: ``observations`` (by number: ``psnr_db``,
        ``camera_rms_m`` of the poses believed, whether each robot ``moved`` and its ``position_m``),
        ``plan_ms`` a candidate (None: not measured here), ``made_from``.
    """
    config, rule = start.config, policy.rule(start.seed)
    team, belief = start.branch()
    folder = RunFolder(run.root / policy.name)
    observations: dict[str, Any] = {}
    images = believed_images(team.mission, belief.localize(team.mission), folder)
    space = start.space(images)
    for number in OBSERVATIONS:
        goals = choose_moves(rule, team, images, space, OBSERVATIONS[-1] - number + 1, config.moves)
        belief.hear(team.go(goals))
        localization = belief.localize(team.mission)
        images = believed_images(team.mission, localization, folder)
        figures = accuracy(localization, team.mission) or {}
        square = [one.position_rms_m**2 for one in figures.values()]
        observations[str(number)] = {
            "psnr_db": _psnr_db(images, space, start.seed, config),
            "camera_rms_m": float(np.sqrt(np.mean(square))),
            "moved": {name: goal is not None for name, goal in goals.items()},
            "position_m": {robot.robot: robot.T_world_camera[:3, 3].tolist() for robot in last_views(images)},
        }
    result = {"observations": observations, "plan_ms": None, "made_from": digest}
    write_json(run.root / f"{policy.name}.json", result)
    return result


def _psnr_db(images: PosedImageSet, space: SceneSpace, seed: int, config: TrialConfig) -> float:
    side = max(config.scene.width, config.scene.height)
    training = TrainConfig(
        image_size=side,
        steps=config.steps,
        batch_samples=config.batch_samples,
        device=Device.CPU,
        seed=seed,
        march=replace(choose_march(side, space.unbounded), steps=_RAY_STEPS),
    )
    field_ = learn_in_memory(load_captured(images.train, side), _WEIGHTS, space, training)
    return judge([field_], load_captured(images.test, side))["psnr_db"]
