"""The power law that turns the paper's AoA metric into a standard deviation (readings.md, row 11)."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import minimize

from mulan.errors import InputError
from mulan.mission.run_folder import write_atomically

_SPHERE_SR = 4 * np.pi
_LEAST_SIGMA_RAD, _LARGEST_SIGMA_RAD = 1e-4, np.pi


@dataclass(frozen=True)
class KappaCalibration:
    """``sigma_aoa_rad = factor * kappa_paper ** exponent``, a tangent-plane Gaussian and an outlier mass.

    Attributes:
        factor: Standard deviation [rad] of one axis at a metric of one; depends on the profile grid.
        exponent: Of the metric.
        outlier_mass: Share of directions that are anywhere on the sphere.
        links: How many links it was fitted to.
    """

    factor: float
    exponent: float
    outlier_mass: float
    links: int

    def sigma_aoa_rad(self, kappa_paper: Float[NDArray, "*b"]) -> Float[NDArray, "*b"]:
        """Standard deviation of one tangent axis, between 0.1 mrad and π."""
        log_sigma = np.log(self.factor) + self.exponent * np.log(np.asarray(kappa_paper, float))
        return np.exp(np.clip(log_sigma, np.log(_LEAST_SIGMA_RAD), np.log(_LARGEST_SIGMA_RAD)))

    def negative_log_density(
        self, kappa_paper: Float[NDArray, "n"], error_rad: Float[NDArray, "n"]
    ) -> Float[NDArray, "n"]:
        """-log of the density [1/sr] the calibrated metric gives the truth at an angular distance."""
        return _negative_log_density(self.sigma_aoa_rad(kappa_paper), error_rad, self.outlier_mass)

    def save(self, path: Path) -> None:
        """Write as JSON."""
        write_atomically(path, lambda temporary: temporary.write_text(json.dumps(asdict(self), indent=1)))


def _negative_log_density(
    sigma_rad: Float[NDArray, "n"], error_rad: Float[NDArray, "n"], outlier_mass: float
) -> Float[NDArray, "n"]:
    gaussian = np.log1p(-outlier_mass) - np.log(2 * np.pi * sigma_rad**2) - 0.5 * (error_rad / sigma_rad) ** 2
    return -np.logaddexp(gaussian, np.log(outlier_mass / _SPHERE_SR))


def fit_kappa_calibration(
    kappa_paper: Float[NDArray, "n"], error_rad: Float[NDArray, "n"], outlier_mass: float | None = None
) -> KappaCalibration:
    """The most likely power law of links with known directions.

    Args:
        kappa_paper: Metric of each link.
        error_rad: Angle between each link's strongest peak and the truth.
        outlier_mass: Fixed, or None to fit it too.

    Raises:
        ValueError: Fewer than ten links.
    """
    if len(kappa_paper) < 10:
        raise ValueError("a power law needs at least ten links")
    log_kappa, centre = np.log(kappa_paper), float(np.log(kappa_paper).mean())

    def unpacked(values: Float[NDArray, "q"]) -> tuple[Float[NDArray, "n"], float]:
        sigma = np.exp(
            np.clip(
                values[0] + values[1] * (log_kappa - centre),
                np.log(_LEAST_SIGMA_RAD),
                np.log(_LARGEST_SIGMA_RAD),
            )
        )
        mass = outlier_mass if outlier_mass is not None else 1e-4 + 0.9 / (1 + np.exp(-values[2]))
        return sigma, mass

    def loss(values: Float[NDArray, "q"]) -> float:
        sigma, mass = unpacked(values)
        return float(_negative_log_density(sigma, error_rad, mass).mean())

    typical = np.log(max(float(np.median(error_rad)), 1e-4))
    tried = [
        minimize(loss, [typical, exponent, -3.0], method="Nelder-Mead", options={"maxiter": 2000})
        for exponent in (0.5, 1.0, 2.0)
    ]
    best = min(tried, key=lambda result: result.fun).x
    mass = unpacked(best)[1]
    return KappaCalibration(
        float(np.exp(best[0] - best[1] * centre)), float(best[1]), float(mass), len(kappa_paper)
    )


def load_kappa_calibration(path: Path) -> KappaCalibration:
    """Read what ``save`` wrote.

    Raises:
        InputError: Not such a file.
    """
    try:
        fields = json.loads(path.read_text())
        return KappaCalibration(
            float(fields["factor"]),
            float(fields["exponent"]),
            float(fields["outlier_mass"]),
            int(fields["links"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            path, "calibration", f"cannot be read ({error})", "write it anew with mulan evaluate aoa-metric"
        ) from error
