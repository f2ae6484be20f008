"""How well a robot will know its pose after a move."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3


@dataclass(frozen=True)
class DriftConfig:
    """Odometry drift over a move."""

    translation_per_metre: float = 0.01
    """Standard deviation of position gained over a metre, on each axis [m]."""
    rotation_rad_per_metre: float = 0.005
    """Standard deviation of rotation gained over a metre, on each axis [rad]."""


def covariance_after_move(
    T_world_camera: Float[NDArray, "4 4"],
    covariance: Float[NDArray, "6 6"],
    T_world_candidate: Float[NDArray, "n 4 4"],
    drift: DriftConfig,
) -> Float[NDArray, "n 6 6"]:
    """Covariance of each candidate pose (right perturbation), if the robot drives there by odometry alone.

    The present covariance is carried through the relative motion; drift adds variance in proportion to the
    square of the distance.
    """
    T_camera_candidate = se3.inverse(T_world_camera) @ T_world_candidate
    carried = se3.covariance_of_composition(
        T_camera_candidate, np.broadcast_to(covariance, (len(T_world_candidate), 6, 6))
    )
    distance_m = np.linalg.norm(T_camera_candidate[:, :3, 3], axis=-1)
    sigma = np.repeat([drift.rotation_rad_per_metre, drift.translation_per_metre], 3) * distance_m[:, None]
    return carried + sigma[:, :, None] ** 2 * np.eye(6)
