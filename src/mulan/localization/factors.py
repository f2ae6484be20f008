"""Bearing and range factors between two robots' poses: analytic Jacobians, lever arms on both ends."""

from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.wireless.directions import tangent_basis

_ANTIPODE = 1e-12  # below this (1 + cos θ)/2 the direction away from the measurement is arbitrary


@dataclass(frozen=True)
class Sight:
    """Which points on two bodies a measurement joins.

    Attributes:
        observer_key, peer_key: Keys of the two body poses.
        observer_body_m, peer_body_m: The points in those bodies' frames.
    """

    observer_key: int
    peer_key: int
    observer_body_m: Float[NDArray, "3"]
    peer_body_m: Float[NDArray, "3"]


def _cross_matrix(w: Float[NDArray, "3"]) -> Float[NDArray, "3 3"]:
    """``so3.hat`` of one vector; half of the solver's time goes through here."""
    x, y, z = w
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def line_of_sight(
    T_world_observer: Float[NDArray, "4 4"], T_world_peer: Float[NDArray, "4 4"], sight: Sight
) -> tuple[Float[NDArray, "3"], Float[NDArray, "3 6"], Float[NDArray, "3 6"]]:
    """Vector from the observer's point to the peer's in the observer's body axes, with its Jacobians.

    For right perturbations (rotation, translation) of the observer and of the peer.
    """
    R_o, R_p = T_world_observer[:3, :3], T_world_peer[:3, :3]
    from_body = R_o.T @ (R_p @ sight.peer_body_m + T_world_peer[:3, 3] - T_world_observer[:3, 3])
    R_o_p = R_o.T @ R_p
    J_observer = np.concatenate([_cross_matrix(from_body), -np.eye(3)], 1)
    J_peer = np.concatenate([-R_o_p @ _cross_matrix(sight.peer_body_m), R_o_p], 1)
    return from_body - sight.observer_body_m, J_observer, J_peer


def bearing_residual(
    v: Float[NDArray, "3"], measured: Float[NDArray, "3"], basis: Float[NDArray, "3 d"]
) -> tuple[Float[NDArray, "d"], Float[NDArray, "d 3"]]:
    """``Bᵀu / sqrt((1 + u·m)/2)`` for u = v/|v|, of length 2 sin(θ/2), and its derivative by v.

    Equal to the angle for small angles and never longer than 2, so a wrong bearing cannot explode at its
    antipode as a logarithm does.
    """
    length = max(float(np.linalg.norm(v)), 1e-9)
    u = v / length
    half_cos2 = (1 + float(u @ measured)) / 2
    if half_cos2 < _ANTIPODE:
        return np.array([2.0, 0.0])[: basis.shape[1]], np.zeros((basis.shape[1], 3))
    gain = half_cos2**-0.5
    across = basis.T @ u
    by_u = gain * basis.T - 0.25 * half_cos2**-1.5 * np.outer(across, measured)
    return gain * across, by_u @ (np.eye(3) - np.outer(u, u)) / length


def level_direction(direction: Float[NDArray, "3"]) -> Float[NDArray, "3"]:
    """The direction's azimuth at the horizon: all that a level aperture measured."""
    flat = direction * [1.0, 1.0, 0.0]
    norm = float(np.linalg.norm(flat))
    return flat / norm if norm > 1e-6 else np.array([1.0, 0.0, 0.0])


def observed_basis(
    direction: Float[NDArray, "3"], covariance: Float[NDArray, "2 2"]
) -> tuple[Float[NDArray, "3"], Float[NDArray, "3 d"], Float[NDArray, "d d"]]:
    """Direction, tangent columns and covariance of what was observed; an infinite axis is left out."""
    seen = np.isfinite(np.diag(covariance))
    if not seen[1]:
        direction = level_direction(direction)
    return direction, tangent_basis(direction)[:, seen], covariance[np.ix_(seen, seen)]


def bearing_factor(
    sight: Sight,
    measured_body: Float[NDArray, "3"],
    basis_body: Float[NDArray, "3 d"],
    noise: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """A direction seen from one body to a point on another.

    Args:
        sight: The two poses and points.
        measured_body: Unit vector in the observer's body axes.
        basis_body: Observed tangent columns there (two, or one where elevation is unknown).
        noise: Over those columns.
    """

    def error(_factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> NDArray:
        v, J_observer, J_peer = line_of_sight(
            values.atPose3(sight.observer_key).matrix(), values.atPose3(sight.peer_key).matrix(), sight
        )
        residual, by_v = bearing_residual(v, measured_body, basis_body)
        if jacobians is not None:
            jacobians[0], jacobians[1] = (
                np.asfortranarray(by_v @ J_observer),
                np.asfortranarray(by_v @ J_peer),
            )
        return residual

    return gtsam.CustomFactor(noise, [sight.observer_key, sight.peer_key], error)


def range_factor(
    sight: Sight, bias_key: int, range_m: float, noise: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """A distance between points on two bodies, plus the constant bias of that pair of radios."""

    def error(_factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: Any) -> NDArray:
        v, J_observer, J_peer = line_of_sight(
            values.atPose3(sight.observer_key).matrix(), values.atPose3(sight.peer_key).matrix(), sight
        )
        distance = max(float(np.linalg.norm(v)), 1e-9)
        if jacobians is not None:
            u = v[None, :] / distance
            jacobians[0], jacobians[1] = np.asfortranarray(u @ J_observer), np.asfortranarray(u @ J_peer)
            jacobians[2] = np.ones((1, 1), order="F")
        return np.array([distance + values.atVector(bias_key)[0] - range_m])

    return gtsam.CustomFactor(noise, [sight.observer_key, sight.peer_key, bias_key], error)
