"""What the graph may learn about a robot's odometry: its scale and how noisy it is."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray


@dataclass(frozen=True)
class OdometryCorrection:
    """What the graph learned about one robot's odometry.

    Attributes:
        scale: Distances travelled are the odometry's times this.
        scale_sigma: Its standard deviation; zero where it was not learned.
        heading_noise, translation_noise: Factors on the sigmas that were given or assumed.
    """

    scale: float = 1.0
    scale_sigma: float = 0.0
    heading_noise: float = 1.0
    translation_noise: float = 1.0


NOT_CORRECTED = OdometryCorrection()
"""The odometry as it came."""


def noise_stretch(
    T_odom_body: Float[NDArray, "m 4 4"], correction: OdometryCorrection, gravity_aligned: bool
) -> Float[NDArray, "m 6 6"]:
    """Symmetric matrices D with D Σ D the corrected covariance of the steps that end at these poses.

    The heading factor acts on turns about the vertical (all turns where nothing knows the vertical).
    """
    D = np.zeros((len(T_odom_body), 6, 6))
    D[:, [3, 4, 5], [3, 4, 5]] = correction.translation_noise
    up = T_odom_body[:, 2, :3] if gravity_aligned else None
    about = np.eye(3) if up is None else up[:, :, None] * up[:, None, :]
    D[:, :3, :3] = np.eye(3) + (correction.heading_noise - 1) * about
    return D


class Learning(StrEnum):
    """For which robots the graph learns the odometry's scale and noise."""

    UNREPORTED = "unreported"
    """Those whose odometry reports no covariance."""
    ALWAYS = "always"
    """All."""
    NEVER = "never"
    """None."""


@dataclass(frozen=True)
class OdometryLearningConfig:
    """Scale and noise of the odometry, learned from how it fits the radio."""

    scale: Learning = Learning.UNREPORTED
    """Whose scale is learned: monocular odometry is off by a percent or so."""
    noise: Learning = Learning.UNREPORTED
    """Whose noise is learned."""
    scale_sigma: float = 0.01
    """How far a scale is from one before anything is known, one sigma."""
    largest_noise_factor: float = 5.0
    """Learned sigmas stay within this factor of what was given or assumed."""
    rounds: int = 8
    """Most rounds of solving and learning."""
