"""Directions as azimuth and elevation, and the tangent axes every bearing covariance refers to."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray


def direction_grid(
    azimuth_count: int, elevation_count: int
) -> tuple[Float[NDArray, "a"], Float[NDArray, "e"]]:
    """Azimuths over [-π, π) and elevations over [-π/2, π/2], both in radians.

    Raises:
        ValueError: The azimuth count is odd or the elevation count even (the profile uses the symmetry).
    """
    if azimuth_count % 2 or not elevation_count % 2:
        raise ValueError("the grid needs an even number of azimuths and an odd number of elevations")
    azimuth_rad = -np.pi + 2 * np.pi * np.arange(azimuth_count) / azimuth_count
    return azimuth_rad, np.linspace(-np.pi / 2, np.pi / 2, elevation_count)


def unit_direction(
    azimuth_rad: Float[NDArray, "*b"], elevation_rad: Float[NDArray, "*b"]
) -> Float[NDArray, "*b 3"]:
    """Unit vectors of azimuths (counter-clockwise from +x) and elevations (up from the horizon)."""
    azimuth_rad, elevation_rad = np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float)
    cos_elevation = np.cos(elevation_rad)
    return np.stack(
        [cos_elevation * np.cos(azimuth_rad), cos_elevation * np.sin(azimuth_rad), np.sin(elevation_rad)], -1
    )


def azimuth_elevation(direction: Float[NDArray, "*b 3"]) -> tuple[Float[NDArray, "*b"], Float[NDArray, "*b"]]:
    """Angles [rad] of unit vectors; the inverse of ``unit_direction``."""
    azimuth_rad = np.arctan2(direction[..., 1], direction[..., 0])
    return np.asarray(azimuth_rad), np.asarray(np.arcsin(np.clip(direction[..., 2], -1.0, 1.0)))


def tangent_basis(direction: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 3 2"]:
    """Orthonormal columns (∂u/∂azimuth / cos(elevation), ∂u/∂elevation); at a pole azimuth counts as zero."""
    azimuth_rad, elevation_rad = azimuth_elevation(direction)
    sin_a, cos_a = np.sin(azimuth_rad), np.cos(azimuth_rad)
    sin_e, cos_e = np.sin(elevation_rad), np.cos(elevation_rad)
    east = np.stack([-sin_a, cos_a, np.zeros_like(sin_a)], -1)
    north = np.stack([-sin_e * cos_a, -sin_e * sin_a, cos_e], -1)
    return np.stack([east, north], -1)
