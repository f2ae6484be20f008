"""Camera poses as a robot would know them from its radio, with the covariance of their errors."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3


@dataclass(frozen=True)
class BelievedPoses:
    """What a robot believes.

    Attributes:
        T_world_camera: Mean poses.
        covariance: Right perturbation of each, (rotation rad, translation m).
        joint_covariance: Of all of them together; None = independent.
    """

    T_world_camera: Float[NDArray, "n 4 4"]
    covariance: Float[NDArray, "n 6 6"]
    joint_covariance: Float[NDArray, "sixn sixn"] | None = None


@dataclass(frozen=True)
class RadioNoiseConfig:
    """A pose an image from one range and one angle of arrival, as in the paper's simulation."""

    sigma_range_m: float = 0.05
    """Standard deviation of a range; also of the height, which the robot's own odometry knows, since the
    plane an antenna moves in tells azimuth only."""
    sigma_aoa_deg: float = 5.0
    """Standard deviation of an azimuth."""
    sigma_orientation_deg: float = 0.5
    """Standard deviation of the camera's orientation about each axis, from the robot's own odometry: a range
    and a bearing give translation only."""


def poses_from_radio(
    T_world_camera: Float[NDArray, "n 4 4"],
    observer_m: Float[NDArray, "n 3"],
    azimuth_error_rad: Float[NDArray, "n"],
    sigma_aoa_rad: Float[NDArray, "n"],
    config: RadioNoiseConfig,
    rng: np.random.Generator,
    likeliest: bool = False,
) -> BelievedPoses:
    """Each camera where the observer's range and azimuth put it.

    An azimuth error turns the position about the vertical through the observer; over a wide angle that is an
    arc, so mean and covariance are the exact moments of the arc, not its tangent's. The mean of a very wide
    arc lies near the observer, where nobody believes the camera to be; the likeliest place lies on the arc.

    Args:
        T_world_camera: True poses.
        observer_m: Where the other robot was as it heard each of them.
        azimuth_error_rad: Measured minus true.
        sigma_aoa_rad: What is believed of those errors.
        config: The other errors.
        rng: Draws the other errors.
        likeliest: Whether a camera is put at its likeliest place, with the mean square about that as
            covariance, instead of at the mean.
    """
    n = len(T_world_camera)
    sigma_orientation_rad = math.radians(config.sigma_orientation_deg)
    R = T_world_camera[:, :3, :3] @ so3.exp(rng.normal(0, sigma_orientation_rad, (n, 3)))
    offset = T_world_camera[:, :3, 3] - observer_m
    across = _across(offset)
    error = rng.normal(0, config.sigma_range_m, (n, 3))
    error -= across * (error * across).sum(1, keepdims=True)
    vertical = np.zeros((n, 3))
    vertical[:, 2] = azimuth_error_rad
    measured = (so3.exp(vertical) @ (offset + error)[..., None])[..., 0]
    mean, position = _moments_of_arc(measured, sigma_aoa_rad)
    if likeliest:
        off = mean - measured
        mean, position = measured, position + off[:, :, None] * off[:, None, :]
    across = _across(measured)
    position += config.sigma_range_m**2 * (np.eye(3) - across[:, :, None] * across[:, None, :])
    covariance = np.zeros((n, 6, 6))
    covariance[:, :3, :3] = sigma_orientation_rad**2 * np.eye(3)
    covariance[:, 3:, 3:] = np.swapaxes(R, 1, 2) @ position @ R
    return BelievedPoses(se3.from_parts(R, observer_m + mean), covariance)


def _across(offset: Float[NDArray, "n 3"]) -> Float[NDArray, "n 3"]:
    """Unit horizontal vectors across the line of sight."""
    across = np.cross([0.0, 0.0, 1.0], offset)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)


def _moments_of_arc(
    offset: Float[NDArray, "n 3"], sigma_rad: Float[NDArray, "n"]
) -> tuple[Float[NDArray, "n 3"], Float[NDArray, "n 3 3"]]:
    """Mean and covariance of vectors turned about the vertical by a normal angle."""
    variance = sigma_rad**2
    mean_cos = np.exp(-variance / 2)
    variance_cos = (1 + np.exp(-2 * variance)) / 2 - np.exp(-variance)
    variance_sin = (1 - np.exp(-2 * variance)) / 2
    along = offset * [1.0, 1.0, 0.0]
    across = np.cross([0.0, 0.0, 1.0], along)
    covariance = (
        variance_cos[:, None, None] * along[:, :, None] * along[:, None, :]
        + variance_sin[:, None, None] * across[:, :, None] * across[:, None, :]
    )
    return mean_cos[:, None] * along + offset * [0.0, 0.0, 1.0], covariance


@dataclass(frozen=True)
class RigidNoiseConfig:
    """One error common to all images of a robot, as a wrong extrinsic makes it, and a little drift."""

    displacement_m: float = 0.4
    """How far the middle of the robot's cameras is displaced."""
    turn_deg: float = 7.0
    """Angle all are turned by about the vertical through that middle."""
    sigma_tilt_deg: float = 0.3
    """Standard deviation of the tilt about each level axis; gravity keeps it small."""
    sigma_drift_m: float = 0.01
    """Standard deviation of each image's own displacement, along each axis."""
    sigma_drift_deg: float = 0.1
    """Standard deviation of each image's own rotation, about each axis."""


def rigidly_displaced_poses(
    T_world_camera: Float[NDArray, "n 4 4"], config: RigidNoiseConfig, rng: np.random.Generator
) -> BelievedPoses:
    """All cameras displaced alike; which way is drawn, how far is as configured.

    The covariance takes the configured displacement and turn as the root mean square of what could have been.
    """
    n = len(T_world_camera)
    middle = se3.from_parts(np.eye(3), T_world_camera[:, :3, 3].mean(0))
    turn_rad, tilt_rad = math.radians(config.turn_deg), math.radians(config.sigma_tilt_deg)
    direction = rng.normal(size=3)
    common = np.concatenate(
        [
            rng.normal(0, tilt_rad, 2),
            [turn_rad * rng.choice([-1.0, 1.0])],
            config.displacement_m * direction / np.linalg.norm(direction),
        ]
    )
    common_variance = np.array([tilt_rad**2] * 2 + [turn_rad**2] + [config.displacement_m**2 / 3] * 3)
    own_variance = np.repeat([math.radians(config.sigma_drift_deg) ** 2, config.sigma_drift_m**2], 3)
    own = rng.normal(size=(n, 6)) * np.sqrt(own_variance)
    # truth = middle exp(common) middle⁻¹ believed exp(own)
    believed = middle @ se3.exp(-common) @ se3.inverse(middle) @ T_world_camera @ se3.inverse(se3.exp(own))
    to_images = se3.adjoint(se3.inverse(believed) @ middle).reshape(6 * n, 6)
    joint = to_images @ np.diag(common_variance) @ to_images.T + np.diag(np.tile(own_variance, n))
    blocks = joint.reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n), :]
    return BelievedPoses(believed, blocks, joint)


def exact_poses(
    T_world_camera: Float[NDArray, "n 4 4"], covariance: Float[NDArray, "n 6 6"]
) -> BelievedPoses:
    """Poses without error of which their robot does not know how good they are."""
    return BelievedPoses(T_world_camera, covariance)
