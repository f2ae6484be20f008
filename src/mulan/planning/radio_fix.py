"""How well a robot would know its pose once its radio has heard the others from a new place."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import so3


@dataclass(frozen=True)
class RadioFixConfig:
    """What one exchange of packets with a teammate tells."""

    sigma_range_m: float = 0.1
    """Standard deviation of a range."""
    sigma_aoa_rad: float = 0.05
    """Standard deviation of a bearing, on each of its two axes."""
    range_m: float = 30.0
    """Teammates farther away are not heard."""


@dataclass(frozen=True)
class Teammate:
    """A robot that can be heard.

    Attributes:
        position_m: Where it stands.
        covariance: Of its position [m²], in world axes.
    """

    position_m: Float[NDArray, "3"]
    covariance: Float[NDArray, "3 3"]


def covariance_after_radio(
    T_world_candidate: Float[NDArray, "n 4 4"],
    covariance: Float[NDArray, "n 6 6"],
    teammates: list[Teammate],
    config: RadioFixConfig,
) -> Float[NDArray, "n 6 6"]:
    """Covariance of each candidate pose (right perturbation) with one range and bearing of every teammate.

    The information ``Jᵀ R⁻¹ J`` of each is added; what is uncertain of the teammate's own position widens R.
    Teammates count as independent. So a place from which they lie in different directions fixes both axes,
    and one near to them fixes the heading's lever less but the position better.
    """
    fused = covariance.copy()
    for i, T in enumerate(T_world_candidate):
        for mate in teammates:
            in_camera = T[:3, :3].T @ (mate.position_m - T[:3, 3])
            distance_m = float(np.linalg.norm(in_camera))
            if not 1e-6 < distance_m <= config.range_m:
                continue
            ahead = in_camera / distance_m
            across = np.linalg.svd(ahead[None])[2][1:]
            of_position = np.vstack([ahead, across / distance_m])
            # a right perturbation (w, v) of the camera moves the teammate by hat(p) w - v in its frame
            J = of_position @ np.hstack([so3.hat(in_camera), -np.eye(3)])
            own = np.diag([config.sigma_range_m**2] + [config.sigma_aoa_rad**2] * 2)
            in_camera_axes = T[:3, :3].T @ mate.covariance @ T[:3, :3]
            noise = own + of_position @ in_camera_axes @ of_position.T
            gain = fused[i] @ J.T @ np.linalg.inv(J @ fused[i] @ J.T + noise)
            fused[i] -= gain @ J @ fused[i]
        fused[i] = (fused[i] + fused[i].T) / 2
    return fused
