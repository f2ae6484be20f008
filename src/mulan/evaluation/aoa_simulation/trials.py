"""One simulated link through the estimator users get."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.aoa_simulation.links import SimulatedLink, aperture_of
from mulan.wireless.bearing import BearingConfig, bearing_of_aperture
from mulan.wireless.directions import tangent_basis, unit_direction

# the floor stands for antenna calibration and clocks, which a simulated link does not have
SIMULATED = BearingConfig(smallest_sigma_rad=0.0)


@dataclass(frozen=True)
class Trial:
    """What the estimator said of one link.

    Attributes:
        error_rad: Angle between each hypothesis and the truth, best hypothesis first.
        top_error_rad: Tangential error of the best hypothesis along (azimuth, elevation).
        covariance: Of the best hypothesis over the same axes.
        negative_log_density: -log of the mixture's density [1/sr] at the truth.
        kappa_paper: The paper's metric.
        peak_error_rad: Angle between the profile's highest cell and the truth, which the paper takes.
        outlier_mass: What the estimator gives to none of its hypotheses.
    """

    error_rad: Float[NDArray, "k"]
    top_error_rad: Float[NDArray, "2"]
    covariance: Float[NDArray, "2 2"]
    negative_log_density: float
    kappa_paper: float
    peak_error_rad: float
    outlier_mass: float

    @property
    def sigma_rad(self) -> float:
        """Root mean of the two variances: one axis's standard deviation."""
        return float(np.sqrt(np.trace(self.covariance) / 2))


def angle_rad(u: Float[NDArray, "*b 3"], v: Float[NDArray, "3"]) -> Float[NDArray, "*b"]:
    """Angle between unit vectors, exact for small angles."""
    return np.asarray(2 * np.arcsin(np.clip(np.linalg.norm(u - v, axis=-1) / 2, 0.0, 1.0)))


def mixture_density(
    direction: Float[NDArray, "k 3"],
    covariance: Float[NDArray, "k 2 2"],
    weight: Float[NDArray, "k"],
    outlier_mass: float,
    truth: Float[NDArray, "3"],
) -> float:
    """Density [1/sr] at the truth of tangent-plane Gaussians and an outlier mass spread over the sphere."""
    density = outlier_mass / (4 * np.pi)
    for u, spread, share in zip(direction, covariance, weight, strict=True):
        if u @ truth <= 0:  # the tangent plane of the far side folds onto the near one
            continue
        error = tangent_basis(u).T @ (truth - u)
        exponent = -0.5 * error @ np.linalg.solve(spread, error)
        density += share * np.exp(exponent) / (2 * np.pi * np.sqrt(np.linalg.det(spread)))
    return float(density)


def run_trial(link: SimulatedLink, range_m: float | None, config: BearingConfig = SIMULATED) -> Trial:
    """Estimate and compare with the truth.

    Args:
        link: The link.
        range_m: Distance the estimator is told, for spherical steering; None for plane waves.
        config: Of the estimator.
    """
    aperture, log = aperture_of(link)
    bearing = bearing_of_aperture(aperture, log, range_m, config)
    assert bearing is not None
    assert bearing.profile is not None
    direction = bearing.direction_odom
    density = mixture_density(
        direction, bearing.tangent_covariance, bearing.weight, bearing.outlier_mass, link.direction
    )
    row, column = np.unravel_index(int(bearing.profile.power.argmax()), bearing.profile.power.shape)
    peak = unit_direction(bearing.profile.azimuth_rad[[column]], bearing.profile.elevation_rad[[row]])[0]
    return Trial(
        angle_rad(direction, link.direction),
        tangent_basis(direction[0]).T @ (link.direction - direction[0]),
        bearing.tangent_covariance[0],
        float(-np.log(density)),
        bearing.kappa_paper,
        float(angle_rad(peak, link.direction)),
        bearing.outlier_mass,
    )
