"""Where a robot is from bearings to radios of known place: a posterior over the plane."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import logsumexp

from mulan.wireless.azimuth_density import AzimuthMixture, wrapped

_YAW_NODES = 7
_AZIMUTH_NODES = 3601
_LEAST_KEPT = 0.25  # of a variance, once the frame's share is taken out
_ROUNDS = 60


@dataclass(frozen=True)
class ResectionConfig:
    """What is known before the bearings."""

    farthest_m: float = 10.0
    """Reach of the radio: the robot is somewhere within it of every radio it heard."""
    cell_m: float = 0.05
    """Spacing of the grid."""


@dataclass(frozen=True)
class SeenRadio:
    """One bearing's azimuths in the odometry's axes, from a point of the path, to a radio of known place.

    Attributes:
        mixture: Over the azimuth; its sigmas hold the odometry frame's turn.
        from_start_m: The point the bearing starts from, from the robot's start, odometry axes.
        radio_m: Place of the radio.
    """

    mixture: AzimuthMixture
    from_start_m: Float[NDArray, "2"]
    radio_m: Float[NDArray, "2"]


@dataclass(frozen=True)
class PlanePosterior:
    """Probability of the start over cells of the plane.

    Attributes:
        place_m: Middles of the cells.
        mass: Of each; they sum to one.
    """

    place_m: Float[NDArray, "n 2"]
    mass: Float[NDArray, "n"]

    @property
    def mean_m(self) -> Float[NDArray, "2"]:
        """Centre of mass."""
        return self.mass @ self.place_m

    @property
    def covariance_m2(self) -> Float[NDArray, "2 2"]:
        """About the mean."""
        off = self.place_m - self.mean_m
        return off.T @ (off * self.mass[:, None])

    @property
    def nearest_m(self) -> Float[NDArray, "2"]:
        """The place of least expected distance to the truth (Weiszfeld): far side lobes pull it less."""
        at = self.mean_m
        for _ in range(_ROUNDS):
            weight = self.mass / np.maximum(np.linalg.norm(self.place_m - at, axis=1), 0.01)
            at = weight @ self.place_m / weight.sum()
        return at

    def level_of(self, at_m: Float[NDArray, "2"]) -> float:
        """Mass of the smallest highest-density region that holds a place."""
        cell = int(np.linalg.norm(self.place_m - at_m, axis=1).argmin())
        return float(self.mass[self.mass > self.mass[cell]].sum() + 0.5 * self.mass[cell])

    def ellipse_level_of(self, at_m: Float[NDArray, "2"]) -> float:
        """Mass of the ellipse about ``nearest_m``, shaped as the covariance, on whose edge a place lies.

        The posterior is no Gaussian: its far side lobes widen the covariance, and the ellipse that holds 68 %
        of it is smaller than the Gaussian's of that covariance.
        """
        return float(self.mass[self._from_nearest(self.place_m) < self._from_nearest(at_m[None])].sum())

    def ellipse_m2(self, share: float) -> Float[NDArray, "2 2"]:
        """Matrix Q of the ellipse ``x^T Q^-1 x = 1`` about ``nearest_m`` that holds a share of the mass."""
        length = self._from_nearest(self.place_m)
        order = length.argsort()
        edge = min(int(np.searchsorted(self.mass[order].cumsum(), share)), len(order) - 1)
        return length[order[edge]] * self.covariance_m2

    def _from_nearest(self, at_m: Float[NDArray, "k 2"]) -> Float[NDArray, "k"]:
        off = at_m - self.nearest_m
        return np.einsum("ni,ij,nj->n", off, np.linalg.inv(self.covariance_m2), off)

    def squared_length(self, at_m: Float[NDArray, "2"]) -> float:
        """Squared Mahalanobis length of a place about the mean."""
        off = at_m - self.mean_m
        return float(off @ np.linalg.solve(self.covariance_m2, off))


def _without_frame(mixture: AzimuthMixture, frame_sigma_rad: float) -> AzimuthMixture:
    """The frame's turn is one for all bearings of a run: out of each, to be counted once."""
    variance = mixture.sigma_rad**2
    kept = np.maximum(variance - frame_sigma_rad**2, _LEAST_KEPT * variance)
    return replace(mixture, sigma_rad=np.sqrt(kept))


def resection(seen: Sequence[SeenRadio], frame_sigma_rad: float, config: ResectionConfig) -> PlanePosterior:
    """Posterior of the robot's start: uniform within reach, the odometry frame's turn integrated out.

    Args:
        seen: Bearings, one or more.
        frame_sigma_rad: Of the turn between the odometry's axes and those the radios' places are given in.
        config: Options.
    """
    radios = np.array([s.radio_m for s in seen])
    low, high = (radios - config.farthest_m).max(0), (radios + config.farthest_m).min(0)
    x, y = np.meshgrid(*(np.arange(a, b, config.cell_m) for a, b in zip(low, high, strict=True)))
    place = np.stack([x.ravel(), y.ravel()], 1)
    place = place[(np.linalg.norm(place[:, None] - radios, axis=2) <= config.farthest_m).all(1)]
    around = np.linspace(-np.pi, np.pi, _AZIMUTH_NODES)
    log_of = [_without_frame(s.mixture, frame_sigma_rad).log_density(around) for s in seen]
    nodes, weights = np.polynomial.hermite_e.hermegauss(_YAW_NODES)
    parts = []
    for yaw, weight in zip(frame_sigma_rad * nodes, weights / weights.sum(), strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        log = np.full(len(place), np.log(weight))
        for sighting, density in zip(seen, log_of, strict=True):
            fx, fy = sighting.from_start_m
            to_radio = sighting.radio_m - place - np.array([c * fx - s * fy, s * fx + c * fy])
            azimuth = wrapped(np.arctan2(to_radio[:, 1], to_radio[:, 0]) - yaw)
            log = log + np.interp(azimuth, around, density)
        parts.append(log)
    log = np.asarray(logsumexp(parts, axis=0))
    mass = np.exp(log - log.max())
    return PlanePosterior(place, mass / mass.sum())
