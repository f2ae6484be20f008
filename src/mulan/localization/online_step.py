"""Drift of one step of odometry, by the rules the batch graph has for whole tracks."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.keyframes import OdometryNoise
from mulan.wireless.odometry_drift import relative_covariance

_LEVEL = np.diag([1.0, 1.0, 0.0])


def tilt_variance_rad2(
    T_odom_body: Float[NDArray, "4 4"],
    covariance: Float[NDArray, "6 6"] | None,
    noise: OdometryNoise,
    gravity_aligned: bool,
) -> float:
    """Bounded error of roll and pitch at a keyframe."""
    if covariance is None or not gravity_aligned:
        return float(np.deg2rad(noise.tilt_deg) ** 2)
    R = T_odom_body[:3, :3]
    in_odom_axes = R @ covariance[:3, :3] @ R.T
    return float(in_odom_axes[0, 0] + in_odom_axes[1, 1]) / 2


def step_covariance(
    T_odom_body: Float[NDArray, "2 4 4"],
    covariance: tuple[Float[NDArray, "6 6"] | None, Float[NDArray, "6 6"] | None],
    tilt_rad2: float,
    noise: OdometryNoise,
    gravity_aligned: bool,
) -> Float[NDArray, "6 6"]:
    """Covariance of the motion from one keyframe to the next (right perturbation of the latter).

    Args:
        T_odom_body: The two poses.
        covariance: Accumulated at each since the start, or None where the driver gives none.
        tilt_rad2: Variance of roll and pitch at the latter.
        noise: Drift assumed where none is given, and floors.
        gravity_aligned: Whether gravity holds roll and pitch.
    """
    before, after = covariance
    if before is None or after is None:
        metres = float(np.linalg.norm(T_odom_body[1, :3, 3] - T_odom_body[0, :3, 3]))
        rotation = np.deg2rad(noise.rotation_deg_per_sqrt_m) ** 2
        translation = (noise.translation_percent / 100) ** 2
        step = metres * np.diag([rotation] * 3 + [translation] * 3)
    else:
        if gravity_aligned:
            before, after = _untilted(T_odom_body[0], before), _untilted(T_odom_body[1], after)
        step = relative_covariance(T_odom_body[0], before, T_odom_body[1], after)
    if gravity_aligned:
        R = T_odom_body[1, :3, :3]
        # tilt errors of two keyframes may differ by twice the variance; gravity factors hold each of them
        step[:3, :3] += 2 * tilt_rad2 * (R.T @ _LEVEL @ R)
    floor = np.array([noise.rotation_floor_rad**2] * 3 + [noise.translation_floor_m**2] * 3)
    return step + np.diag(floor)


def _untilted(T: Float[NDArray, "4 4"], covariance: Float[NDArray, "6 6"]) -> Float[NDArray, "6 6"]:
    """Only rotation about the vertical: bounded tilt is no random walk and cannot be differenced."""
    keep = np.eye(6)
    keep[:3, :3] = np.outer(T[2, :3], T[2, :3])
    return keep @ covariance @ keep.T
