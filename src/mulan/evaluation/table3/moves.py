"""The moves a robot can choose from, and the choice."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import takewhile

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.table3.policies import Rule
from mulan.geometry import se3
from mulan.mission.posed_images import PosedImageSet
from mulan.planning.candidates import CandidateConfig, ring_of_candidates
from mulan.planning.knowledge import Knowledge
from mulan.planning.plan import RobotView
from mulan.planning.pose_growth import DriftConfig, covariance_after_move
from mulan.planning.radio_fix import RadioFixConfig, Teammate, covariance_after_radio
from mulan.planning.run_files import last_views, looked_at_m
from mulan.planning.team_plan import teammate
from mulan.planning.team_run import TEAM_LOOKS, EnsembleConfig, chosen_views, learnt_ensemble
from mulan.planning.view import View
from mulan.planning.ways import Way
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import load_captured
from mulan.simulation.recording import T_BODY_CAMERA
from mulan.simulation.team_in_world import TeamInWorld


@dataclass(frozen=True)
class MoveConfig:
    """What a robot can do next."""

    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    """Eight moves of half a metre."""
    drift: DriftConfig = field(default_factory=DriftConfig)
    """What a candidate's covariance gains on the way."""
    radio: RadioFixConfig = field(default_factory=RadioFixConfig)
    """What it loses by the radio there."""
    ensemble: EnsembleConfig = field(default_factory=EnsembleConfig)
    """The small fields that plan."""


def choose_moves(
    rule: Rule, team: TeamInWorld, images: PosedImageSet, space: SceneSpace, left: int, config: MoveConfig
) -> dict[str, Float[NDArray, "4 4"] | None]:
    """True goal of each robot, one after another, each knowing what those before it will see.

    Args:
        rule: Judges the moves.
        team: The robots; their own sensors say what is free.
        images: Photographs so far with believed poses.
        space: Where the scene is.
        left: Moves each robot may still make, this one included.
        config: The moves.
    """
    needed, fields = rule.fields_needed, []
    if needed:
        photographs = load_captured(images.train, config.ensemble.image_size)
        fields = learnt_ensemble(photographs, space, replace(config.ensemble, members=needed))
    knowledge = Knowledge(fields, space, chosen_views(images), TEAM_LOOKS)
    robots = last_views(images)
    goals: dict[str, Float[NDArray, "4 4"] | None] = {}
    for robot in robots:
        T_true_believed = team.T_world_body[robot.robot] @ T_BODY_CAMERA @ se3.inverse(robot.T_world_camera)

        reachable = partial(_is_reachable, team, robot.robot, T_true_believed, goals)
        mates = [teammate(other) for other in robots if other is not robot]
        ways = _ways(robot, looked_at_m(images), mates, left if rule.looks_ahead else 1, reachable, config)
        if not ways:
            goals[robot.robot] = None
            continue
        best = ways[int(np.argmax(rule(knowledge, ways)))]
        goals[robot.robot] = T_true_believed @ best[0].T_world_camera
        for view in best:
            knowledge = knowledge.with_chosen(view)
    return goals


def _ways(
    robot: RobotView,
    centre_m: Float[NDArray, "3"],
    mates: list[Teammate],
    moves: int,
    reachable: Callable[[Float[NDArray, "4 4"]], bool],
    config: MoveConfig,
) -> list[Way]:
    """Each of the eight moves and what lies straight on, as far as the robot's sensors see the way free."""
    ring = config.candidates
    further = [
        ring_of_candidates(
            robot.T_world_camera, centre_m, replace(ring, distance_m=(k + 1) * ring.distance_m)
        )
        for k in range(moves)
    ]
    ways: list[Way] = []
    for direction in range(ring.directions):
        poses = list(takewhile(reachable, (T[direction] for T in further)))
        if not poses:
            continue
        T = np.stack(poses)
        moved = covariance_after_move(robot.T_world_camera, robot.covariance, T, config.drift)
        covariance = covariance_after_radio(T, moved, mates, config.radio)
        ways.append([View(robot.camera, pose, cov) for pose, cov in zip(T, covariance, strict=True)])
    return ways


def _is_reachable(
    team: TeamInWorld,
    name: str,
    T_true_believed: Float[NDArray, "4 4"],
    goals: Mapping[str, Float[NDArray, "4 4"] | None],
    T_world_camera: Float[NDArray, "4 4"],
) -> bool:
    """Whether a robot's sensors see the straight way to a believed pose free."""
    return team.can_go(name, T_true_believed @ T_world_camera, goals)
