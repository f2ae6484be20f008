"""How much a robot's dead reckoning may have drifted between two instants."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.mission.types import OdometryTrack


def covariance_at(odometry: OdometryTrack, time_s: Float[NDArray, "q"]) -> Float[NDArray, "q 6 6"] | None:
    """Accumulated covariance at given times, linear between samples; None where the driver gives none."""
    if odometry.covariance is None:
        return None
    n = len(odometry.time_s)
    at = np.interp(time_s, odometry.time_s, np.arange(n))
    low = np.clip(at.astype(int), 0, n - 1)
    high = np.minimum(low + 1, n - 1)
    fraction = (at - low)[:, None, None]
    return (1 - fraction) * odometry.covariance[low] + fraction * odometry.covariance[high]


def relative_covariance(
    T_odom_i: Float[NDArray, "*b 4 4"],
    covariance_i: Float[NDArray, "*b 6 6"],
    T_odom_j: Float[NDArray, "*b 4 4"],
    covariance_j: Float[NDArray, "*b 6 6"],
) -> Float[NDArray, "*b 6 6"]:
    """Covariance of ``T_i_j`` from accumulated covariances: ``Σ_j - Ad(T_i_j⁻¹) Σ_i Ad(T_i_j⁻¹)ᵀ``.

    Drift after i is independent of drift before it. Negative eigenvalues (from rounding and from drivers
    whose covariance is not a random walk) are set to zero.
    """
    T_i_j = se3.inverse(T_odom_i) @ T_odom_j
    difference = covariance_j - se3.covariance_of_composition(T_i_j, covariance_i)
    value, vector = np.linalg.eigh((difference + np.swapaxes(difference, -1, -2)) / 2)
    return (vector * np.maximum(value, 0.0)[..., None, :]) @ np.swapaxes(vector, -1, -2)


def displacement_covariance(
    odometry: OdometryTrack, time_s: Float[NDArray, "q"]
) -> Float[NDArray, "q 3 3"] | None:
    """Covariance [m²] in odometry axes of the drift in position since ``time_s[0]``; None where unknown."""
    covariance = covariance_at(odometry, time_s)
    if covariance is None:
        return None
    T = se3.interpolate(odometry.time_s, odometry.T_odom_body, time_s)
    start, start_covariance = np.broadcast_to(T[0], T.shape), np.broadcast_to(covariance[0], covariance.shape)
    relative = relative_covariance(start, start_covariance, T, covariance)[:, 3:, 3:]
    R = T[:, :3, :3]
    return R @ relative @ np.swapaxes(R, 1, 2)
