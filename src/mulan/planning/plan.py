"""From where every robot is to the view each should take next."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera
from mulan.planning.candidates import CandidateConfig, free_candidates
from mulan.planning.pose_growth import DriftConfig, covariance_after_move
from mulan.planning.score import (
    CandidateView,
    LiteralPosterior,
    PropagatedPosterior,
    variance_reduction,
)
from mulan.radiance.engine import RadianceEngine


@dataclass(frozen=True)
class PlanConfig:
    """How the next views are chosen."""

    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    """Where a robot could go."""
    drift: DriftConfig = field(default_factory=DriftConfig)
    """What odometry loses on the way."""
    posterior: PropagatedPosterior | LiteralPosterior = field(default_factory=PropagatedPosterior)
    """How pose uncertainty enters the score."""
    columns: int = 32
    """Rays across a candidate's image; the rows follow from its aspect."""


@dataclass(frozen=True)
class RobotView:
    """Where one robot's camera is now.

    Attributes:
        robot: Name.
        camera: Intrinsics.
        T_world_camera: Last camera pose (OpenGL axes).
        covariance: Its covariance (right perturbation; rotation rad, translation m).
    """

    robot: str
    camera: PinholeCamera
    T_world_camera: Float[NDArray, "4 4"]
    covariance: Float[NDArray, "6 6"]


@dataclass(frozen=True)
class RobotPlan:
    """What one robot could do next, and what it should.

    Attributes:
        robot: Where it is.
        T_world_candidate: Free candidate camera poses.
        covariance: Covariance each would have there.
        score: What each is worth by itself.
        best: Candidate to take; None where nowhere is free or nothing worth the way, and the robot stays.
    """

    robot: RobotView
    T_world_candidate: Float[NDArray, "n 4 4"]
    covariance: Float[NDArray, "n 6 6"]
    score: Float[NDArray, "n"]
    best: int | None


@dataclass(frozen=True)
class ViewPlan:
    """The next view of every robot.

    Attributes:
        robots: One plan a robot, in the order given.
        centre_m: The scene centre the candidates look at.
        score_meaning: What the scores are, in a few words and their unit.
    """

    robots: tuple[RobotPlan, ...]
    centre_m: Float[NDArray, "3"]
    score_meaning: str = "expected variance reduction per ray"


def plan_views(
    engine: RadianceEngine,
    robots: Sequence[RobotView],
    centre_m: Float[NDArray, "3"],
    config: PlanConfig,
    progress: Callable[[int, int, str], None] | None = None,
) -> ViewPlan:
    """Score every free candidate of every robot by the paper's rule, posterior variance reduction.

    Scores are in colour units squared, summed along a ray; each robot takes its best.

    Args:
        engine: The trained field.
        robots: Last camera poses with covariance.
        centre_m: Scene centre in the world.
        config: Candidates, drift and score.
        progress: Called with (done, total, robot name).
    """
    plans = []
    for index, robot in enumerate(robots):
        if progress is not None:
            progress(index, len(robots), robot.robot)
        poses = free_candidates(engine, robot.T_world_camera, centre_m, config.candidates)
        covariance = covariance_after_move(robot.T_world_camera, robot.covariance, poses, config.drift)
        score = np.array(
            [
                variance_reduction(
                    engine, CandidateView(robot.camera, T, cov, config.columns), config.posterior
                )
                for T, cov in zip(poses, covariance, strict=True)
            ],
            dtype=float,
        )
        best = int(np.argmax(score)) if len(score) else None
        plans.append(RobotPlan(robot, poses, covariance, score, best))
    if progress is not None:
        progress(len(robots), len(robots), "done")
    return ViewPlan(tuple(plans), centre_m)
