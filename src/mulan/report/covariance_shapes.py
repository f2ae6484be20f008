"""Outlines of 95 % confidence regions."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

# square roots of the 95 % quantiles of chi-squared with two and three degrees of freedom
_SIGMAS_95_PLANE = 2.4477468
SIGMAS_95_SPACE = 2.7954835
_EXAGGERATIONS = (1, 2, 5, 10, 20, 50, 100)
_SMALLEST_VISIBLE_SHARE = 0.012  # of the map's extent


def position_covariance_world(
    T_world_body: Float[NDArray, "n 4 4"], covariance: Float[NDArray, "n 6 6"]
) -> Float[NDArray, "n 3 3"]:
    """World-axes covariance of positions, from right-perturbation covariances (rotation, translation)."""
    R = T_world_body[:, :3, :3]
    return R @ covariance[:, 3:, 3:] @ np.swapaxes(R, 1, 2)


def ellipse_95(
    centre: Float[NDArray, "2"], covariance: Float[NDArray, "2 2"], exaggeration: int, points: int = 40
) -> Float[NDArray, "p 2"]:
    """Closed outline of the 95 % ellipse in the plane."""
    angle = np.linspace(0, 2 * np.pi, points)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    return centre + exaggeration * _SIGMAS_95_PLANE * circle @ _square_root(covariance)


def ellipsoid_95(
    centre: Float[NDArray, "3"], covariance: Float[NDArray, "3 3"], exaggeration: int, points: int = 28
) -> list[Float[NDArray, "p 3"]]:
    """The three principal outlines of the 95 % ellipsoid in space."""
    angle = np.linspace(0, 2 * np.pi, points)
    c, s, o = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    eigenvalue, axes = np.linalg.eigh(covariance)
    scaled = axes * np.sqrt(np.clip(eigenvalue, 0, None)) * exaggeration * SIGMAS_95_SPACE
    rings = (np.stack([c, s, o], -1), np.stack([c, o, s], -1), np.stack([o, c, s], -1))
    return [centre + ring @ scaled.T for ring in rings]


def exaggeration_for(covariance: Float[NDArray, "n 3 3"], extent_m: float) -> int:
    """Smallest round factor at which the larger half of the ellipses can be seen on a map of that extent.

    One where they can be seen as they are; the page must state any other.
    """
    if not len(covariance) or extent_m <= 0:
        return 1
    semi_axis = _SIGMAS_95_PLANE * np.sqrt(np.clip(np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1], 0, None))
    typical = float(np.quantile(semi_axis, 0.75))
    for factor in _EXAGGERATIONS:
        if factor * typical >= _SMALLEST_VISIBLE_SHARE * extent_m:
            return factor
    return 1 if typical < 1e-6 * extent_m else _EXAGGERATIONS[-1]


def _square_root(covariance: Float[NDArray, "d d"]) -> Float[NDArray, "d d"]:
    eigenvalue, axes = np.linalg.eigh(covariance)
    return (axes * np.sqrt(np.clip(eigenvalue, 0, None))) @ axes.T
