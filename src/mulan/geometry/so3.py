"""Rotations: exponential, logarithm, quaternions (x, y, z, w), yaw."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

_SMALL_ANGLE_RAD = 1e-4  # below this the Taylor series is exact to float64


def hat(w: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 3 3"]:
    """Skew-symmetric matrix with ``hat(w) @ v == cross(w, v)``."""
    zero = np.zeros_like(w[..., 0])
    x, y, z = w[..., 0], w[..., 1], w[..., 2]
    rows = [np.stack(r, -1) for r in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, -2)


def _series(angle: Float[NDArray, "*b"]) -> tuple[Float[NDArray, "*b"], ...]:
    """sin(a)/a, (1-cos a)/a², (a-sin a)/a³, by series near zero."""
    small = angle < _SMALL_ANGLE_RAD
    a = np.where(small, 1.0, angle)
    a2 = angle**2
    s = np.where(small, 1 - a2 / 6, np.sin(a) / a)
    # 2 sin²(a/2) avoids the cancellation of 1 - cos(a)
    c = np.where(small, 0.5 - a2 / 24, 2 * np.sin(a / 2) ** 2 / a**2)
    d = np.where(angle < 1e-2, 1 / 6 - a2 / 120 + a2**2 / 5040, (a - np.sin(a)) / a**3)
    return s, c, d


def exp(w: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 3 3"]:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = np.asarray(np.linalg.norm(w, axis=-1))
    s, c, _ = _series(angle)
    W = hat(w)
    return np.eye(3) + s[..., None, None] * W + c[..., None, None] * (W @ W)


def log(R: Float[NDArray, "*b 3 3"]) -> Float[NDArray, "*b 3"]:
    """Rotation vector of a rotation matrix, |w| <= pi, stable up to pi."""
    q = to_quaternion(R)
    q = np.where(q[..., 3:] < 0, -q, q)
    v, w = q[..., :3], q[..., 3]
    n = np.linalg.norm(v, axis=-1)
    small = n < 1e-8
    angle = 2 * np.arctan2(n, w)
    scale = np.where(small, 2 / np.where(w == 0, 1.0, w), angle / np.where(small, 1.0, n))
    return scale[..., None] * v


def left_jacobian(w: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 3 3"]:
    """V(w) with exp_se3 translation = V(w) @ v (Barfoot, State Estimation for Robotics, eq. 7.37b)."""
    angle = np.asarray(np.linalg.norm(w, axis=-1))
    _, c, d = _series(angle)
    W = hat(w)
    return np.eye(3) + c[..., None, None] * W + d[..., None, None] * (W @ W)


def to_quaternion(R: Float[NDArray, "*b 3 3"]) -> Float[NDArray, "*b 4"]:
    """Unit quaternion (x, y, z, w) with w >= 0 where it is not zero."""
    m = R.reshape(-1, 3, 3)
    # the row of the largest diagonal term of 4qqᵀ is free of cancellation (Shepperd 1978)
    K = np.empty((len(m), 4, 4))
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    K[:, 0, 0], K[:, 1, 1], K[:, 2, 2], K[:, 3, 3] = (
        1 + xx - yy - zz,
        1 - xx + yy - zz,
        1 - xx - yy + zz,
        1 + xx + yy + zz,
    )
    K[:, 0, 1] = K[:, 1, 0] = m[:, 0, 1] + m[:, 1, 0]
    K[:, 0, 2] = K[:, 2, 0] = m[:, 0, 2] + m[:, 2, 0]
    K[:, 1, 2] = K[:, 2, 1] = m[:, 1, 2] + m[:, 2, 1]
    K[:, 0, 3] = K[:, 3, 0] = m[:, 2, 1] - m[:, 1, 2]
    K[:, 1, 3] = K[:, 3, 1] = m[:, 0, 2] - m[:, 2, 0]
    K[:, 2, 3] = K[:, 3, 2] = m[:, 1, 0] - m[:, 0, 1]
    best = np.argmax(np.einsum("nii->ni", K), axis=1)
    q = K[np.arange(len(m)), best]
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    q = np.where(q[:, 3:] < 0, -q, q)
    return q.reshape(*R.shape[:-2], 4)


def from_quaternion(q: Float[NDArray, "*b 4"]) -> Float[NDArray, "*b 3 3"]:
    """Rotation matrix of a quaternion (x, y, z, w), normalised first."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    v, w = q[..., :3], q[..., 3, None, None]
    V = hat(v)
    return np.eye(3) + 2 * w * V + 2 * (V @ V)


def about_z(yaw_rad: Float[NDArray, "*b"] | float) -> Float[NDArray, "*b 3 3"]:
    """Rotation by a yaw angle about the vertical."""
    yaw = np.asarray(yaw_rad, float)
    return exp(np.stack([np.zeros_like(yaw), np.zeros_like(yaw), yaw], -1))


def yaw_rad(R: Float[NDArray, "*b 3 3"]) -> Float[NDArray, "*b"]:
    """Heading of the body's x axis in the horizontal plane."""
    return np.asarray(np.arctan2(R[..., 1, 0], R[..., 0, 0]))
