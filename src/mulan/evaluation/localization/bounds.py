"""The smallest error poses can have (Cramér–Rao), from the truth and apart from the estimator's code."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.evaluation.localization.simulated_team import (
    CAMERA_BODY_M,
    UWB_BODY_M,
    WIFI_BODY_M,
    Noise,
    SimulatedTeam,
    step_sigma,
)

_UP = np.array([0.0, 0.0, 1.0])

_OPEN = 1e6  # a variance [m² or rad²] that only rounding keeps from being infinite


def _turned(arm: Float[NDArray, "m 3"]) -> Float[NDArray, "m 3 4"]:
    """Motion of the end of a lever arm (world axes) by a pose's (yaw, x, y, z) in world axes."""
    identity = np.broadcast_to(np.eye(3), (len(arm), 3, 3))
    return np.concatenate([np.cross(_UP, arm)[..., None], identity], axis=2)


@dataclass(frozen=True)
class _Measured:
    """Whitened derivatives of measurements by the poses of observer and peer at one sample.

    Attributes:
        observer, peer, sample: Indices.
        by_observer, by_peer: Derivatives by (yaw, x, y, z) of those poses in world axes.
    """

    observer: Int[NDArray, "m"]
    peer: Int[NDArray, "m"]
    sample: Int[NDArray, "m"]
    by_observer: Float[NDArray, "m d 4"]
    by_peer: Float[NDArray, "m d 4"]


def _bearings(team: SimulatedTeam, noise: Noise) -> _Measured:
    o, q, i = team.bearing_at[team.bearing_right].T
    v, arm_o, arm_q = _sight(team, o, q, i, WIFI_BODY_M)
    distance = np.linalg.norm(v, axis=1)[:, None, None]
    u = v[:, :, None] / distance
    across = (np.eye(3) - u @ np.swapaxes(u, 1, 2)) / distance / np.deg2rad(noise.bearing_deg)
    by_observer = -_turned(arm_o)
    by_observer[..., 0] -= np.cross(_UP, v)  # the direction is seen from the observer's body, which turns
    return _Measured(o, q, i, across @ by_observer, across @ _turned(arm_q))


def _ranges(team: SimulatedTeam, noise: Noise) -> _Measured:
    o, q, i = team.range_at[team.range_right].T
    v, arm_o, arm_q = _sight(team, o, q, i, UWB_BODY_M)
    along = (v / np.linalg.norm(v, axis=1)[:, None] / noise.range_m)[:, None]
    return _Measured(o, q, i, -along @ _turned(arm_o), along @ _turned(arm_q))


def _sight(
    team: SimulatedTeam,
    o: Int[NDArray, "m"],
    q: Int[NDArray, "m"],
    i: Int[NDArray, "m"],
    antenna_body_m: Float[NDArray, "3"],
) -> tuple[Float[NDArray, "m 3"], Float[NDArray, "m 3"], Float[NDArray, "m 3"]]:
    """From the observer's antenna to the peer's, and both lever arms, in world axes."""
    T = team.T_truth_body
    arm_o, arm_q = T[o, i, :3, :3] @ antenna_body_m, T[q, i, :3, :3] @ antenna_body_m
    return T[q, i, :3, 3] + arm_q - T[o, i, :3, 3] - arm_o, arm_o, arm_q


def _from_start(p: Float[NDArray, "n 3"]) -> Float[NDArray, "n 4 4"]:
    """Motion of every pose of a robot with exact odometry by the (yaw, x, y, z) of its first."""
    moved = np.zeros((len(p), 4, 4))
    moved[:, 0, 0] = 1.0
    moved[:, 1:] = _turned(p - p[0])
    return moved


def _odometry_rows(p: Float[NDArray, "n 3"], noise: Noise) -> scipy.sparse.csr_matrix:
    """Whitened derivative of a robot's dead reckoning by its poses (4 columns each)."""
    n, step = len(p), np.diff(p, axis=0)
    sigma = step_sigma(np.linalg.norm(step, axis=1), noise)
    weight = 1 / np.concatenate([sigma[:, :1], np.repeat(sigma[:, 1:], 3, 1)], 1)[..., None]
    after = np.broadcast_to(np.eye(4), (n - 1, 4, 4))
    before = -after.copy()
    before[:, 1:, 0] = -np.cross(_UP, step)  # a step is seen from the pose it starts at, which turns
    k = np.arange(n - 1)
    return _rows(4 * n, (k, weight * before), (k + 1, weight * after))


def _rows(columns: int, *parts: tuple[Int[NDArray, "m"], Float[NDArray, "m d 4"]]) -> scipy.sparse.csr_matrix:
    """Sparse rows, m times d of them, from blocks that belong to the block columns given."""
    value = np.concatenate([blocks for _, blocks in parts], axis=2)
    m, d, _ = value.shape
    at = np.concatenate([4 * block[:, None] + np.arange(4) for block, _ in parts], axis=1)
    column = np.broadcast_to(at[:, None], value.shape)
    row = np.broadcast_to(np.arange(m * d).reshape(m, d)[..., None], value.shape)
    return scipy.sparse.csr_matrix((value.ravel(), (row.ravel(), column.ravel())), shape=(m * d, columns))


def camera_bound(team: SimulatedTeam, noise: Noise, drifting: bool) -> Float[NDArray, "others photos"]:
    """Bound on the mean squared error [m²] of every camera position of all robots but the anchor.

    Freedoms are yaw and position of each start frame, or, where odometry drifts, of every pose; the anchor's
    first pose is fixed. The Fisher information is that of the right measurements at the truth; where it
    leaves a freedom open, all bounds are infinite.
    """
    T = team.T_truth_body
    R, p = T[..., :3, :3], T[..., :3, 3]
    robots, samples = p.shape[:2]
    measured = (_bearings(team, noise), _ranges(team, noise))
    if drifting:
        J: list[Any] = [
            _rows(
                4 * robots * samples,
                (m.observer * samples + m.sample, m.by_observer),
                (m.peer * samples + m.sample, m.by_peer),
            )
            for m in measured
        ]
        J.append(scipy.sparse.block_diag([_odometry_rows(path, noise) for path in p]))
        photo = np.arange(1, robots)[:, None] * samples + team.photo_at
        found = _covariance(scipy.sparse.vstack(J), photo.ravel())
        own = None if found is None else found.reshape(robots - 1, -1, 4, 4)
    else:
        moved = np.array([_from_start(path) for path in p])
        J = [
            _rows(
                4 * robots,
                (m.observer, m.by_observer @ moved[m.observer, m.sample]),
                (m.peer, m.by_peer @ moved[m.peer, m.sample]),
            )
            for m in measured
        ]
        start = _covariance(scipy.sparse.vstack(J), np.arange(1, robots))
        at = moved[1:, team.photo_at]
        own = None if start is None else at @ start[:, None] @ np.swapaxes(at, 2, 3)
    if own is None:
        return np.full((robots - 1, len(team.photo_at)), np.inf)
    arm = (R[1:, team.photo_at] @ CAMERA_BODY_M).reshape(-1, 3)
    to_camera = _turned(arm).reshape(robots - 1, -1, 3, 4)
    return np.einsum("rpia,rpab,rpib->rp", to_camera, own, to_camera)


def _covariance(J: Any, wanted: Int[NDArray, "w"]) -> Float[NDArray, "w 4 4"] | None:
    """Blocks of the inverse information for some poses, None if it is singular; the first pose is fixed."""
    J = J.tocsc()[:, 4:]
    try:
        factor = scipy.sparse.linalg.splu((J.T @ J).tocsc())
    except RuntimeError:  # "Factor is exactly singular"
        return None
    found = np.empty((len(wanted), 4, 4))
    for block, pose in enumerate(wanted):
        at = 4 * (int(pose) - 1) + np.arange(4)
        unit = np.zeros((J.shape[1], 4))
        unit[at, np.arange(4)] = 1.0
        found[block] = factor.solve(unit)[at]
    variance = np.diagonal(found, axis1=1, axis2=2)
    return found if ((variance > 0) & (variance < _OPEN)).all() else None
