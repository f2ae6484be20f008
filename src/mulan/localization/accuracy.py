"""How far the estimate is from the ground truth, and whether its covariance says so."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3
from mulan.localization.types import Localization
from mulan.mission.types import Mission, RobotLog


@dataclass(frozen=True)
class RobotAccuracy:
    """Errors of one robot's photograph poses in the anchor's start frame.

    Attributes:
        position_rms_m: Root mean square distance.
        rotation_rms_deg: Root mean square angle.
        yaw_rms_deg: Its part about the vertical.
        nees_per_dof: Mean squared error in units of the claimed covariance over six freedoms; 1 is honest,
            more is overconfident.
    """

    position_rms_m: float
    rotation_rms_deg: float
    yaw_rms_deg: float
    nees_per_dof: float


def world_from_truth(mission: Mission) -> Float[NDArray, "4 4"] | None:
    """``T_world_truth``: the frame of the ground truth in the anchor's start frame; None without truth.

    The anchor's true pose at the start of its odometry is laid on its odometry pose there.
    """
    anchor = mission.robots[0]
    if anchor.ground_truth is None:
        return None
    odometry = anchor.odometry
    true = se3.interpolate(anchor.ground_truth.time_s, anchor.ground_truth.T_world_body, odometry.time_s[:1])[
        0
    ]
    return odometry.T_odom_body[0] @ se3.inverse(true)


def true_poses(
    robot: RobotLog, T_world_truth: Float[NDArray, "4 4"], time_s: Float[NDArray, "n"]
) -> Float[NDArray, "n 4 4"] | None:
    """True body poses in the anchor's start frame at times on the robot's clock; None without truth."""
    if robot.ground_truth is None:
        return None
    return T_world_truth @ se3.interpolate(robot.ground_truth.time_s, robot.ground_truth.T_world_body, time_s)


def accuracy(localization: Localization, mission: Mission) -> dict[str, RobotAccuracy] | None:
    """Errors by robot name, for robots with ground truth; None if the anchor has none."""
    T_world_truth = world_from_truth(mission)
    if T_world_truth is None:
        return None
    result = {}
    for name, trajectory in localization.trajectories.items():
        true = true_poses(mission.robot(name), T_world_truth, trajectory.time_s)
        if true is None or len(true) == 0:
            continue
        estimate = trajectory.T_world_body
        xi = se3.log(se3.inverse(estimate) @ true)
        turn = so3.log(estimate[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2))
        nees = np.einsum("ni,ni->n", xi, np.linalg.solve(trajectory.covariance, xi[..., None])[..., 0])
        off = np.linalg.norm(estimate[:, :3, 3] - true[:, :3, 3], axis=1)
        result[name] = RobotAccuracy(
            position_rms_m=_rms(off),
            rotation_rms_deg=float(np.degrees(_rms(np.linalg.norm(turn, axis=1)))),
            yaw_rms_deg=float(np.degrees(_rms(turn[:, 2]))),
            nees_per_dof=float(nees.mean() / 6),
        )
    return result


def _rms(values: Float[NDArray, "n"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
