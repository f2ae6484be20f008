"""Rigid transforms as 4x4 matrices; tangent order (rotation, translation), right perturbation."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import so3


def from_parts(R: Float[NDArray, "*b 3 3"], t: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 4 4"]:
    """Rigid transform of a rotation and a translation."""
    batch = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    T = np.zeros((*batch, 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Float[NDArray, "*b 4 4"]) -> Float[NDArray, "*b 4 4"]:
    """Inverse of rigid transforms."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return from_parts(Rt, -(Rt @ T[..., :3, 3, None])[..., 0])


def transform(T: Float[NDArray, "*b 4 4"], points: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 3"]:
    """Points moved by rigid transforms, batched alike."""
    return (T[..., :3, :3] @ points[..., None])[..., 0] + T[..., :3, 3]


def exp(xi: Float[NDArray, "*b 6"]) -> Float[NDArray, "*b 4 4"]:
    """Rigid transform of a twist (rotation, translation)."""
    w, v = xi[..., :3], xi[..., 3:]
    return from_parts(so3.exp(w), (so3.left_jacobian(w) @ v[..., None])[..., 0])


def log(T: Float[NDArray, "*b 4 4"]) -> Float[NDArray, "*b 6"]:
    """Twist (rotation, translation) of a rigid transform."""
    w = so3.log(T[..., :3, :3])
    v = np.linalg.solve(so3.left_jacobian(w), T[..., :3, 3, None])[..., 0]
    return np.concatenate([w, v], -1)


def adjoint(T: Float[NDArray, "*b 4 4"]) -> Float[NDArray, "*b 6 6"]:
    """Ad(T) with ``T @ exp(xi) == exp(Ad(T) @ xi) @ T``."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    A = np.zeros((*T.shape[:-2], 6, 6))
    A[..., :3, :3] = A[..., 3:, 3:] = R
    A[..., 3:, :3] = so3.hat(t) @ R
    return A


def covariance_of_composition(
    T_b_c: Float[NDArray, "*b 4 4"], covariance_a_b: Float[NDArray, "*b 6 6"]
) -> Float[NDArray, "*b 6 6"]:
    """Covariance of ``T_a_c = T_a_b @ T_b_c`` when only ``T_a_b`` is uncertain (right perturbation).

    ``T_a_b exp(xi) T_b_c = T_a_c exp(Ad(T_b_c⁻¹) xi)``.
    """
    A = adjoint(inverse(T_b_c))
    return A @ covariance_a_b @ np.swapaxes(A, -1, -2)


def interpolate(
    time_s: Float[NDArray, "n"], T: Float[NDArray, "n 4 4"], query_s: Float[NDArray, "q"]
) -> Float[NDArray, "q 4 4"]:
    """Poses at query times along the geodesic between the neighbouring samples; ends are held."""
    query = np.clip(query_s, time_s[0], time_s[-1])
    if len(time_s) == 1:
        return np.repeat(T, len(query), axis=0)
    hi = np.clip(np.searchsorted(time_s, query, side="right"), 1, len(time_s) - 1)
    lo = hi - 1
    fraction = (query - time_s[lo]) / np.maximum(time_s[hi] - time_s[lo], 1e-12)
    return T[lo] @ exp(fraction[:, None] * log(inverse(T[lo]) @ T[hi]))
