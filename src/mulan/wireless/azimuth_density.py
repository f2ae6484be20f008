"""What a bearing claims about the azimuth: a density on the circle, its intervals and its spread."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from mulan.wireless.directions import azimuth_elevation
from mulan.wireless.types import Bearing

_TURNS = 2 * np.pi * np.arange(-2, 3)
_WIDEST_SIGMA_RAD = np.pi  # a wrapped Gaussian this wide is uniform within 2 %
_CIRCLE_NODES = 361
_PEAK_NODES, _PEAK_SIGMAS = 100, 10.0


def wrapped(angle_rad: Float[NDArray, "*b"]) -> Float[NDArray, "*b"]:
    """Angles in [-π, π)."""
    return (np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi


def log_wrapped_gaussians(
    off_rad: Float[NDArray, "*b"], sigma_rad: Float[NDArray, "#*b"]
) -> Float[NDArray, "*b"]:
    """Log density [1/rad] of Gaussians wrapped around the circle, at angles off their means."""
    off = wrapped(off_rad)[..., None] + _TURNS
    sigma = sigma_rad[..., None]
    return np.asarray(logsumexp(-0.5 * (off / sigma) ** 2, axis=-1)) - np.log(np.sqrt(2 * np.pi) * sigma_rad)


@dataclass(frozen=True)
class AzimuthMixture:
    """Wrapped Gaussians plus a uniform outlier mass.

    Highest-density regions are cut from the Gaussians' part: the uniform part shifts the density by a
    constant, so the order of the azimuths is the same, and no two far ones tie.

    Attributes:
        mean_rad: K azimuths, best first.
        sigma_rad: Their standard deviations, at most π.
        weight: Their probabilities.
        outlier_mass: The rest, spread over the circle.
    """

    mean_rad: Float[NDArray, "k"]
    sigma_rad: Float[NDArray, "k"]
    weight: Float[NDArray, "k"]
    outlier_mass: float

    def _log_gaussians(self, azimuth_rad: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        log = log_wrapped_gaussians(azimuth_rad[:, None] - self.mean_rad, self.sigma_rad)
        return np.asarray(logsumexp(log, axis=1, b=self.weight))

    def log_density(self, azimuth_rad: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """Natural logarithm of the density [1/rad]; minus it is the negative log-likelihood of a truth."""
        with np.errstate(divide="ignore"):
            return np.logaddexp(
                self._log_gaussians(np.asarray(azimuth_rad, float)), np.log(self.outlier_mass / (2 * np.pi))
            )

    @cached_property
    def _cells(self) -> tuple[Float[NDArray, "n"], Float[NDArray, "n"], Float[NDArray, "m"]]:
        """Nodes around the circle, the Gaussians' log density there, and the exact mass between them."""
        step = np.linspace(0.0, 1.0, _PEAK_NODES + 1) ** 2 * _PEAK_SIGMAS
        near = self.mean_rad[:, None] + self.sigma_rad[:, None] * np.concatenate([-step[:0:-1], step])
        nodes = np.unique(np.concatenate([wrapped(near.ravel()), np.linspace(-np.pi, np.pi, _CIRCLE_NODES)]))
        off = nodes[:, None, None] - wrapped(self.mean_rad)[:, None] + _TURNS
        below = ndtr(off / self.sigma_rad[:, None]).sum(2) @ self.weight
        mass = np.diff(below) + self.outlier_mass * np.diff(nodes) / (2 * np.pi)
        return nodes, self._log_gaussians(nodes), mass / mass.sum()

    def _mass_above(self, log_level: Float[NDArray, "t"]) -> Float[NDArray, "t"]:
        """Probability of all azimuths where the Gaussians' log density is higher."""
        _, height, mass = self._cells
        low, high = np.minimum(height[:-1], height[1:]), np.maximum(height[:-1], height[1:])
        share = (high - log_level[:, None]) / np.maximum(high - low, 1e-12)
        return np.clip(share, 0.0, 1.0) @ mass

    def level_of(self, azimuth_rad: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """The smallest level, in 0..1, whose highest-density region contains each azimuth.

        If the mixture is right, the levels of the truths are uniform; a truth is inside the 95 % region
        exactly if its level is at most 0.95.
        """
        return self._mass_above(self._log_gaussians(np.asarray(azimuth_rad, float)))

    def interval(self, level: float) -> Float[NDArray, "arcs 2"]:
        """The highest-density region of a level: arcs from begin to end, counter-clockwise, in radians.

        Begins lie in [-π, π); an end may lie beyond π where the arc crosses it. Level 1 is the whole circle.
        """
        nodes, height, _ = self._cells
        if level >= 1.0:
            return np.array([[-np.pi, np.pi]])
        low, high = float(height.min()), float(height.max())
        for _ in range(60):
            middle = 0.5 * (low + high)
            if self._mass_above(np.array([middle]))[0] > level:
                low = middle
            else:
                high = middle
        inside = height > low
        if inside.all():
            return np.array([[-np.pi, np.pi]])
        rising, falling = np.flatnonzero(~inside[:-1] & inside[1:]), np.flatnonzero(inside[:-1] & ~inside[1:])
        begin, end = (
            nodes[at] + (low - height[at]) / (height[at + 1] - height[at]) * (nodes[at + 1] - nodes[at])
            for at in (rising, falling)
        )
        if inside[0]:
            end = np.append(end[1:], end[:1] + 2 * np.pi)
        return np.stack([begin, end], 1)

    @property
    def sigma_azimuth_rad(self) -> float:
        """Root mean square of the azimuth about the first hypothesis, the whole mixture counted.

        This is the error to expect of the first hypothesis alone, and so the number that ranks errors.
        """
        nodes, _, mass = self._cells
        off = wrapped(0.5 * (nodes[:-1] + nodes[1:]) - self.mean_rad[0])
        return float(np.sqrt(mass @ (off**2 + np.diff(nodes) ** 2 / 12)))

    @property
    def mean_abs_azimuth_rad(self) -> float:
        """Mean absolute azimuth about the first hypothesis; a small outlier mass sways it less."""
        nodes, _, mass = self._cells
        return float(mass @ np.abs(wrapped(0.5 * (nodes[:-1] + nodes[1:]) - self.mean_rad[0])))


def azimuth_mixture(bearing: Bearing) -> AzimuthMixture:
    """The azimuths of a bearing, in the observer's odometry axes.

    A tangent's first axis is an arc of length cos(elevation) per radian of azimuth.
    """
    azimuth_rad, elevation_rad = azimuth_elevation(bearing.direction_odom)
    sigma = np.sqrt(bearing.tangent_covariance[:, 0, 0]) / np.maximum(np.cos(elevation_rad), 1e-6)
    return AzimuthMixture(
        azimuth_rad, np.clip(sigma, 1e-5, _WIDEST_SIGMA_RAD), bearing.weight, float(bearing.outlier_mass)
    )
