"""How far believed cameras are from the true ones, and whether their covariance admits it."""

import math
from typing import Any

import numpy as np

from mulan.evaluation.table1.team import Team
from mulan.geometry import se3, so3
from mulan.mission.posed_images import PosedImageSet


def camera_errors(team: Team, images: PosedImageSet) -> dict[str, Any]:
    """Errors of the cameras whose poses are not exact, raw, in the anchor's frame.

    Args:
        team: Tells the true poses and which cameras are not exact.
        images: Photographs of the team at the poses a setup ended with.

    Returns:
        ``camera_rms_m``, ``camera_median_m``, ``camera_max_m``, ``camera_rotation_median_deg`` (all 0 where
        every pose is exact) and ``nees_per_dof`` (1 = honest; None where no pose has a covariance): the mean
        over the cameras of squared error over covariance, over 6.
    """
    true = {image.path: image.T_world_camera for image in team.true.train}
    uncertain = {image.path for image in team.believed.train if image.pose_covariance is not None}
    chosen = [image for image in images.train if image.path in uncertain]
    if not chosen:
        names = ("camera_rms_m", "camera_median_m", "camera_max_m", "camera_rotation_median_deg")
        return dict.fromkeys(names, 0.0) | {"nees_per_dof": None}
    error = np.stack([se3.inverse(image.T_world_camera) @ true[image.path] for image in chosen])
    position = np.stack([image.T_world_camera[:3, 3] - true[image.path][:3, 3] for image in chosen])
    distance = np.linalg.norm(position, axis=1)
    angle = np.linalg.norm(so3.log(error[:, :3, :3]), axis=1)
    nees = [
        float(xi @ np.linalg.solve(image.pose_covariance, xi))
        for xi, image in zip(se3.log(error), chosen, strict=True)
        if image.pose_covariance is not None
    ]
    return {
        "camera_rms_m": math.sqrt(float((distance**2).mean())),
        "camera_median_m": float(np.median(distance)),
        "camera_max_m": float(distance.max()),
        "camera_rotation_median_deg": math.degrees(float(np.median(angle))),
        "nees_per_dof": sum(nees) / len(nees) / 6 if nees else None,
    }
