"""Visual-inertial dead reckoning: position and yaw wander with distance, gravity holds roll and pitch."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3
from mulan.mission.types import OdometryTrack


@dataclass(frozen=True)
class OdometryNoiseConfig:
    """How fast dead reckoning drifts."""

    translation_drift_percent: float = 1.0
    """Position random walk: 1 % adds 0.01 m (one sigma, each axis) over the first metre and grows with the
    square root of the distance."""
    rotation_drift_deg_per_sqrt_m: float = 0.1
    """Yaw random walk, degrees (one sigma) after one metre."""
    tilt_sigma_deg: float = 0.05
    """Roll and pitch error, degrees (one sigma); gravity keeps it from growing beyond this."""
    tilt_correlation_s: float = 10.0
    """Seconds over which the roll and pitch error forgets itself."""


def start_frame(T_world_body: Float[NDArray, "4 4"]) -> Float[NDArray, "4 4"]:
    """The odometry frame of a robot that wakes up at a pose: its position and yaw, z up."""
    return se3.from_parts(so3.about_z(so3.yaw_rad(T_world_body[:3, :3])), T_world_body[:3, 3])


def simulate_odometry(
    time_s: Float[NDArray, "n"],
    T_world_body: Float[NDArray, "n 4 4"],
    config: OdometryNoiseConfig,
    rng: np.random.Generator,
) -> OdometryTrack:
    """Dead reckoning along true body poses, in the robot's own start frame.

    The first pose has position zero, yaw zero and the true roll and pitch. Yaw error is a random walk over
    the distance travelled and turns every later step; each position axis gets its own random walk; roll and
    pitch errors are a first-order Gauss-Markov process that starts at zero.

    Returns:
        Poses with the exact first-order covariance accumulated since the start (right perturbation; rotation
        rad, translation m). It is zero at the first sample and does not grow where the robot stands still.
    """
    T_true = se3.inverse(start_frame(T_world_body[0])) @ T_world_body
    R, p = T_true[:, :3, :3], T_true[:, :3, 3]
    steps_m = np.diff(p, axis=0)
    length_m = np.linalg.norm(steps_m, axis=1)
    yaw_variance_step = np.deg2rad(config.rotation_drift_deg_per_sqrt_m) ** 2 * length_m
    position_variance_step = (config.translation_drift_percent / 100) ** 2 * length_m

    yaw = _accumulate(rng.normal(size=len(steps_m)) * np.sqrt(yaw_variance_step))
    tilt, tilt_variance = _gauss_markov(
        time_s, np.deg2rad(config.tilt_sigma_deg), config.tilt_correlation_s, rng
    )
    turned = (so3.about_z(yaw[:-1]) @ steps_m[:, :, None])[:, :, 0]
    wander = rng.normal(size=steps_m.shape) * np.sqrt(position_variance_step)[:, None]
    rotation_error = so3.exp(np.column_stack([tilt, np.zeros(len(yaw))]))
    T_odom_body = se3.from_parts(so3.about_z(yaw) @ rotation_error @ R, _accumulate(turned + wander))
    world = _covariance_in_odom_axes(p, yaw_variance_step, position_variance_step, tilt_variance)
    to_body = np.zeros((len(p), 6, 6))
    to_body[:, :3, :3] = to_body[:, 3:, 3:] = np.swapaxes(R, 1, 2)
    covariance = to_body @ world @ np.swapaxes(to_body, 1, 2)
    return OdometryTrack(time_s, T_odom_body, (covariance + np.swapaxes(covariance, 1, 2)) / 2)


def _accumulate(steps: Float[NDArray, "m *axes"]) -> Float[NDArray, "n *axes"]:
    """Running sum that starts at zero, one longer than the steps."""
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def _gauss_markov(
    time_s: Float[NDArray, "n"], sigma_rad: float, correlation_s: float, rng: np.random.Generator
) -> tuple[Float[NDArray, "n 2"], Float[NDArray, "n"]]:
    """Two independent first-order Gauss-Markov tracks that start at zero, and their variance."""
    decay = np.exp(-np.diff(time_s) / correlation_s)
    kick = rng.normal(size=(len(decay), 2)) * (sigma_rad * np.sqrt(1 - decay**2))[:, None]
    track = np.zeros((len(time_s), 2))
    for k in range(len(decay)):
        track[k + 1] = decay[k] * track[k] + kick[k]
    return track, sigma_rad**2 * (1 - np.exp(-2 * (time_s - time_s[0]) / correlation_s))


def _covariance_in_odom_axes(
    p: Float[NDArray, "n 3"],
    yaw_variance_step: Float[NDArray, "m"],
    position_variance_step: Float[NDArray, "m"],
    tilt_variance: Float[NDArray, "n"],
) -> Float[NDArray, "n 6 6"]:
    """Covariance of (rotation, position) errors in the odometry axes.

    A yaw kick at p_j moves the end by ``kick * z × (p_N - p_j)``, so with running sums Q = Σq, m = Σq p and
    S = Σq ppᵀ the position covariance is J (Q ppᵀ - p mᵀ - m pᵀ + S) Jᵀ, J = hat(z).
    """
    kick_point = p[1:]
    Q = _accumulate(yaw_variance_step)
    m = _accumulate(yaw_variance_step[:, None] * kick_point)
    S = _accumulate(yaw_variance_step[:, None, None] * kick_point[:, :, None] * kick_point[:, None, :])
    J = so3.hat(np.array([0.0, 0.0, 1.0]))
    p_mT = p[:, :, None] * m[:, None, :]
    spread = Q[:, None, None] * p[:, :, None] * p[:, None, :] - p_mT - np.swapaxes(p_mT, 1, 2) + S
    cross = (Q[:, None] * p - m) @ J.T

    covariance = np.zeros((len(p), 6, 6))
    covariance[:, 0, 0] = covariance[:, 1, 1] = tilt_variance
    covariance[:, 2, 2] = Q
    covariance[:, 2, 3:] = covariance[:, 3:, 2] = cross
    covariance[:, 3:, 3:] = J @ spread @ J.T + _accumulate(position_variance_step)[:, None, None] * np.eye(3)
    return covariance
