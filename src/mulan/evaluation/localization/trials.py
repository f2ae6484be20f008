"""One simulated team through the localization users get, and many of them summed up."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.localization.bounds import camera_bound
from mulan.evaluation.localization.simulated_team import (
    CAMERA_BODY_M,
    Case,
    Noise,
    SimulatedTeam,
    draw_team,
    told_share,
)
from mulan.geometry import se3, so3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.localize import localize_from_measurements
from mulan.localization.types import Localization

FIGURES = (
    "rms_m",
    "bound_m",
    "rms_over_bound",
    "rms_m_standard_error",
    "median_m",
    "worst_m",
    "yaw_rms_deg",
    "nees_per_dof",
    "nees_per_dof_standard_error",
    "nees_per_dof_median",
)
"""What is measured of a case: over its trials, each the mean over robots and photographs."""

_ILL_POSED = 3.0  # a bound so many times the median bound


@dataclass(frozen=True)
class Trial:
    """Errors of one team, over all robots but the anchor.

    Attributes:
        squared_m2: Of every camera position.
        bound_m2: What the Cramér–Rao bound allows there.
        yaw_rad: Heading error of every photograph.
        nees: Squared error of yaw and position at every photograph in units of the claimed covariance.
        seconds: Processor time the estimator took.
        refused: What the estimator said of a robot it could not place; the arrays are empty then.
    """

    squared_m2: Float[NDArray, "n"]
    bound_m2: Float[NDArray, "n"]
    yaw_rad: Float[NDArray, "n"]
    nees: Float[NDArray, "n"]
    seconds: float
    refused: str = ""


def told(case: Case) -> LocalizationConfig:
    """The estimator knows the noise it is given: radios without bias, odometry that reports its own drift."""
    return LocalizationConfig(
        range_bias_sigma_m=0.0,
        range_outlier_mass=told_share(case.outlier_share),
    )


def draw(case: Case, noise: Noise, seed: int, index: int) -> SimulatedTeam:
    """The team of one trial: the same for the same case, seed and index on every machine."""
    return draw_team(np.random.default_rng([seed, index, *case.name.encode()]), case, noise)


def run_trial(case: Case, noise: Noise, seed: int, index: int) -> Trial:
    """Draw, localize, compare."""
    team = draw(case, noise, seed, index)
    began = process_time()
    localization = localize_from_measurements(team.robots, team.bearings, team.ranges, told(case))
    seconds = process_time() - began
    if localization.undetermined:
        nothing = np.zeros(0)
        return Trial(nothing, nothing, nothing, nothing, seconds, str(localization.undetermined[0].error()))
    squared, yaw, nees = _errors(team, localization)
    return Trial(squared, camera_bound(team, noise, case.drifting).ravel(), yaw, nees, seconds)


def _errors(team: SimulatedTeam, localization: Localization) -> tuple[NDArray, NDArray, NDArray]:
    """Squared camera error [m²], yaw error [rad] and NEES of yaw and position, one a photograph."""
    T_truth = team.T_truth_body[:, team.photo_at]
    T_true = se3.inverse(team.T_truth_body[0, 0]) @ T_truth[1:]
    found = [localization.trajectories[robot.name] for robot in team.robots[1:]]
    T = np.array([trajectory.T_world_body for trajectory in found])
    covariance = np.array([trajectory.covariance for trajectory in found])
    R = T[..., :3, :3]
    camera = np.broadcast_to(CAMERA_BODY_M, T[..., :3, 3].shape)
    squared = ((se3.transform(T, camera) - se3.transform(T_true, camera)) ** 2).sum(-1)
    turn = so3.log(T_true[..., :3, :3] @ np.swapaxes(R, -1, -2))
    error = np.concatenate([turn[..., 2:], T_true[..., :3, 3] - T[..., :3, 3]], -1)
    to_world = np.zeros((*T.shape[:2], 4, 6))
    to_world[..., 0, :3], to_world[..., 1:, 3:] = R[..., 2, :], R
    spread = to_world @ covariance @ np.swapaxes(to_world, -1, -2)
    nees = (error * np.linalg.solve(spread, error[..., None])[..., 0]).sum(-1)
    return squared.ravel(), error[..., 0].ravel(), nees.ravel()


def summed_up(case: Case, trials: Sequence[Trial]) -> dict[str, Any]:
    """A case's line of ``metrics.json``; teams the estimator refused to place are counted, not scored.

    Errors leave out teams whose right measurements hardly determine the poses: a single bound of metres would
    hide every error of the others. They are counted, and their NEES counts.
    """
    answered = [trial for trial in trials if not trial.refused]
    line: dict[str, Any] = {
        "robots": case.robots,
        "meetings": case.meetings,
        "outlier_share": case.outlier_share,
        "drifting": case.drifting,
        "trials": len(trials),
        "refused": len(trials) - len(answered),
        "median_seconds": float(np.median([trial.seconds for trial in trials])),
    }
    if not answered:
        return line | dict.fromkeys(FIGURES)
    bound = np.array([trial.bound_m2.mean() for trial in answered])
    posed = bound <= _ILL_POSED**2 * np.median(bound)
    line["ill_posed"] = int((~posed).sum())
    bound = bound[posed]
    squared = np.array([trial.squared_m2.mean() for trial in answered])[posed]
    yaw = np.array([(trial.yaw_rad**2).mean() for trial in answered])[posed]
    nees = np.array([trial.nees.mean() / 4 for trial in answered])
    rms_m, bound_m = np.sqrt(squared.mean()), np.sqrt(bound.mean())
    count = np.sqrt(len(squared))
    figures = (
        rms_m,
        bound_m,
        rms_m / bound_m,
        squared.std() / count / (2 * rms_m),
        np.sqrt(np.median(squared)),
        np.sqrt(squared.max()),
        np.degrees(np.sqrt(yaw.mean())),
        nees.mean(),
        nees.std() / np.sqrt(len(nees)),
        np.median(nees),
    )
    return line | {name: float(value) for name, value in zip(FIGURES, figures, strict=True)}
