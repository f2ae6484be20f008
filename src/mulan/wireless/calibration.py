"""Recalibrated bearings: a map of four numbers from what the estimator claims to what recordings bear out."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, logit, logsumexp

from mulan.errors import InputError
from mulan.mission.json_fields import number
from mulan.mission.run_folder import read_json, write_json
from mulan.wireless.azimuth_density import azimuth_mixture, log_wrapped_gaussians
from mulan.wireless.directions import azimuth_elevation
from mulan.wireless.types import Bearing

FORMAT = "mulan azimuth calibration 1"
_REMEDY = "make it again with 'mulan calibrate'"
_PRIOR_SIGMA = 1.5  # of each parameter below; lets data speak, keeps a dozen links from running away
_SMALLEST_FLOOR_RAD = 1e-3
_FEWEST_LINKS = 10
_OUTLIER_BOUNDS = (1e-4, 0.99)


@dataclass(frozen=True)
class AzimuthCalibration:
    """σ' = √((scale σ)² + floor²), weights to a power, the odds of an outlier times a factor."""

    sigma_scale: float = 1.0
    """Factor on every hypothesis's standard deviation."""
    sigma_floor_rad: float = 0.0
    """Added to it in quadrature: what no residual of one aperture shows."""
    weight_exponent: float = 1.0
    """Power the hypotheses' weights are raised to; below 1 they tell less which one is right."""
    outlier_odds_factor: float = 1.0
    """Factor on outlier mass : rest."""

    def applied(self, bearing: Bearing) -> Bearing:
        """The bearing with recalibrated covariances, weights and outlier mass; directions stay."""
        if self == AzimuthCalibration():
            return bearing
        covariance = self.sigma_scale**2 * bearing.tangent_covariance + self.sigma_floor_rad**2 * np.eye(2)
        weight, outlier_mass = self.probabilities(bearing.weight, np.array(bearing.outlier_mass))
        return replace(
            bearing, tangent_covariance=covariance, weight=weight, outlier_mass=float(outlier_mass)
        )

    def probabilities(
        self, weight: Float[NDArray, "*n k"], outlier_mass: Float[NDArray, "*n"]
    ) -> tuple[Float[NDArray, "*n k"], Float[NDArray, "*n"]]:
        """Recalibrated weights and outlier masses; hypotheses of weight zero keep it."""
        outlier = expit(logit(np.clip(outlier_mass, *_OUTLIER_BOUNDS)) + np.log(self.outlier_odds_factor))
        power = np.where(weight > 0, np.maximum(weight, 1e-300) ** self.weight_exponent, 0.0)
        return power / power.sum(-1, keepdims=True) * (1 - outlier)[..., None], outlier


@dataclass(frozen=True)
class _Claims:
    """Azimuth mixtures of n bearings as arrays, short ones filled up with hypotheses of weight zero."""

    mean_rad: Float[NDArray, "n k"]
    sigma_rad: Float[NDArray, "n k"]
    cos_elevation: Float[NDArray, "n k"]
    weight: Float[NDArray, "n k"]
    outlier_mass: Float[NDArray, "n"]

    def mean_nll(self, calibration: AzimuthCalibration, true_azimuth_rad: Float[NDArray, "n"]) -> float:
        """Mean negative log-likelihood of the truths once recalibrated."""
        floor = calibration.sigma_floor_rad / self.cos_elevation
        sigma = np.hypot(calibration.sigma_scale * self.sigma_rad, floor).clip(1e-5, np.pi)
        weight, outlier = calibration.probabilities(self.weight, self.outlier_mass)
        log = log_wrapped_gaussians(true_azimuth_rad[:, None] - self.mean_rad, sigma)
        return -float(np.mean(np.logaddexp(logsumexp(log, axis=1, b=weight), np.log(outlier / (2 * np.pi)))))


def _claims(bearings: Sequence[Bearing]) -> _Claims:
    shape = (len(bearings), max(len(b.weight) for b in bearings))
    mean, sigma, cosine, weight = np.zeros(shape), np.ones(shape), np.ones(shape), np.zeros(shape)
    for row, bearing in enumerate(bearings):
        mixture, k = azimuth_mixture(bearing), len(bearing.weight)
        mean[row, :k], sigma[row, :k], weight[row, :k] = mixture.mean_rad, mixture.sigma_rad, mixture.weight
        cosine[row, :k] = np.maximum(np.cos(azimuth_elevation(bearing.direction_odom)[1]), 1e-6)
    return _Claims(mean, sigma, cosine, weight, np.array([float(b.outlier_mass) for b in bearings]))


def mean_nll(bearings: Sequence[Bearing], true_azimuth_rad: Float[NDArray, "n"]) -> float:
    """Mean negative log-likelihood [nats, density per radian] of the true azimuths."""
    return _claims(bearings).mean_nll(AzimuthCalibration(), true_azimuth_rad)


def fit_calibration(bearings: Sequence[Bearing], true_azimuth_rad: Float[NDArray, "n"]) -> AzimuthCalibration:
    """Maximum likelihood of the true azimuths under the mixtures, with a weak prior towards no change.

    Args:
        bearings: As the estimator gives them.
        true_azimuth_rad: In the same axes.

    Raises:
        ValueError: Fewer than ten bearings.
    """
    if len(bearings) < _FEWEST_LINKS:
        raise ValueError(f"{len(bearings)} bearings are too few to calibrate on, {_FEWEST_LINKS} are needed")

    claims = _claims(bearings)

    def loss(x: Float[NDArray, "4"]) -> float:
        nll = claims.mean_nll(_from_parameters(x), true_azimuth_rad)
        return nll * len(bearings) + 0.5 * float(((x - _NO_CHANGE) ** 2).sum()) / _PRIOR_SIGMA**2

    start = np.array([0.0, np.log(10.0), 0.0, 0.0])
    simplex = start + np.vstack([np.zeros(4), 0.5 * np.eye(4)])
    found = minimize(
        loss,
        start,
        method="Nelder-Mead",
        options={"xatol": 5e-3, "fatol": 5e-3, "maxfev": 600, "initial_simplex": simplex},
    )
    return _from_parameters(found.x)


# logarithms of scale, floor over its smallest value, exponent, odds factor
_NO_CHANGE = np.zeros(4)


def _from_parameters(x: Float[NDArray, "4"]) -> AzimuthCalibration:
    scale, floor, exponent, odds = np.exp(np.clip(x, -7.0, 7.0))
    return AzimuthCalibration(float(scale), float(floor) * _SMALLEST_FLOOR_RAD, float(exponent), float(odds))


def write_calibration(path: Path, calibration: AzimuthCalibration, record: dict[str, Any]) -> None:
    """Save a calibration with whatever tells where it comes from."""
    write_json(path, {"format": FORMAT, **asdict(calibration), **record})


def read_calibration(path: Path) -> AzimuthCalibration:
    """Load what ``write_calibration`` saved.

    Raises:
        InputError: The file is missing, is no calibration, or a number is missing or out of range.
    """
    record = read_json(path, "mulan calibrate")
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise InputError(path, "format", f"is not '{FORMAT}'", _REMEDY)
    values = {}
    for name in AzimuthCalibration.__dataclass_fields__:
        value = number(record, name, path)
        if value is None:
            raise InputError(path, name, "is missing", _REMEDY)
        if value < 0 or (value == 0 and name != "sigma_floor_rad"):
            raise InputError(path, name, f"is {value:g}, not positive", _REMEDY)
        values[name] = value
    return AzimuthCalibration(**values)
