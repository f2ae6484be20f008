"""How likely every bearing and range is at given poses, right or wrong, also were they turned or biased."""

from collections.abc import Sequence

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import so3
from mulan.localization.factors import observed_basis
from mulan.localization.graph import BearingNode, LocalizationGraph, RangeNode, sight_vector
from mulan.wireless.types import Bearing

DETOUR_SPAN_M = 10.0
"""Wrong ranges are spread over so many metres."""


def _padded(
    bearings: Sequence[Bearing],
) -> tuple[Float[NDArray, "m k 3"], Float[NDArray, "m k 2 3"], Float[NDArray, "m k"]]:
    """Directions, whiteners and log of weight over norm of every hypothesis; absent ones have weight zero."""
    most = max((len(b.weight) for b in bearings), default=0)
    direction, whitener = np.zeros((len(bearings), most, 3)), np.zeros((len(bearings), most, 2, 3))
    log_weight = np.full((len(bearings), most), -np.inf)
    for i, bearing in enumerate(bearings):
        for k, weight in enumerate(bearing.weight):
            u, basis, covariance = observed_basis(bearing.direction_odom[k], bearing.tangent_covariance[k])
            root = np.linalg.cholesky(covariance)
            direction[i, k] = u
            whitener[i, k, : len(root)] = np.linalg.solve(root, basis.T)
            norm = np.log(np.diag(root)).sum() + 0.5 * len(root) * np.log(2 * np.pi)
            log_weight[i, k] = np.log(max(float(weight), 1e-300)) - norm
    return direction, whitener, log_weight


def wrong_bearing_log_likelihood(bearings: Sequence[Bearing]) -> Float[NDArray, "m"]:
    """Of every bearing if it is an outlier: any azimuth, and any height where that was observed."""
    level = np.array([not np.isfinite(b.tangent_covariance[0, 1, 1]) for b in bearings], dtype=bool)
    mass = np.array([max(b.outlier_mass, 1e-12) for b in bearings], dtype=float)
    return np.log(mass) - np.log(np.where(level, 2 * np.pi, 4 * np.pi))


def true_directions_odom(values: gtsam.Values, nodes: Sequence[BearingNode]) -> Float[NDArray, "m 3"]:
    """Where each bearing should point, in its observer's odometry axes, at given poses."""
    v = [node.R_body_odom.T @ sight_vector(values, node.sight) for node in nodes]
    u = np.array(v, dtype=float).reshape(-1, 3)
    return u / np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-9)


def bearing_log_likelihood(
    values: gtsam.Values, nodes: Sequence[BearingNode], turned_rad: Float[NDArray, "g"]
) -> Float[NDArray, "g m"]:
    """Of every bearing's mixture, were it the truth turned about the observer's vertical by each angle."""
    if not nodes:
        return np.zeros((len(turned_rad), 0))
    bearings = [node.bearing for node in nodes]
    direction, whitener, log_weight = _padded(bearings)
    expected = np.einsum("gij,mj->gmi", so3.about_z(turned_rad), true_directions_odom(values, nodes))
    across = np.einsum("mkij,gmj->gmki", whitener, expected)
    half_cos2 = np.maximum((1 + np.einsum("mki,gmi->gmk", direction, expected)) / 2, 1e-12)
    squared = (across**2).sum(-1) / half_cos2
    right = np.logaddexp.reduce(log_weight - 0.5 * squared, axis=-1)
    return np.logaddexp(right, wrong_bearing_log_likelihood(bearings))


def range_residuals_m(values: gtsam.Values, nodes: Sequence[RangeNode]) -> Float[NDArray, "r"]:
    """Measured less expected, the bias of the pair counted in."""
    expected = [
        np.linalg.norm(sight_vector(values, node.sight)) + values.atVector(node.bias_key)[0] for node in nodes
    ]
    return np.array([node.measurement.range_m for node in nodes], dtype=float) - np.array(
        expected, dtype=float
    )


def wrong_range_log_likelihood(outlier_mass: float) -> float:
    """Of a range that took a detour."""
    return float(np.log(max(outlier_mass, 1e-12)) - np.log(DETOUR_SPAN_M))


def range_log_likelihood(
    residual_m: Float[NDArray, "r"],
    sigma_m: Float[NDArray, "r"],
    outlier_mass: float,
    bias_m: Float[NDArray, "g"],
) -> Float[NDArray, "g r"]:
    """Of every range, were all of them too long by each bias."""
    z = (residual_m[None] - bias_m[:, None]) / sigma_m
    right = np.log1p(-outlier_mass) - 0.5 * z**2 - np.log(np.sqrt(2 * np.pi) * sigma_m)
    return np.logaddexp(right, wrong_range_log_likelihood(outlier_mass))


def motion_log_likelihood(graph: LocalizationGraph, values: gtsam.Values) -> float:
    """Of odometry, gravity, floor and biases, up to a constant."""
    return -float(graph.motion_factors().error(values))
