"""The smallest error poses can have (Cramér–Rao), from the truth and apart from the estimator's code."""

import numpy as np
from jaxtyping import Float
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


def _turned(arm: Float[NDArray, "m 3"]) -> Float[NDArray, "m 3 4"]:
    """Motion of the end of a lever arm (world axes) by a pose's (yaw, x, y, z) in world axes."""
    identity = np.broadcast_to(np.eye(3), (len(arm), 3, 3))
    return np.concatenate([np.cross(_UP, arm)[..., None], identity], axis=2)


def _measured(team: SimulatedTeam, noise: Noise) -> Float[NDArray, "rows robots samples 4"]:
    """Whitened derivative of every right measurement by every pose."""
    T = team.T_truth_body
    R, p = T[..., :3, :3], T[..., :3, 3]
    rows = []
    for at, right, lever in (
        (team.bearing_at, team.bearing_right, WIFI_BODY_M),
        (team.range_at, team.range_right, UWB_BODY_M),
    ):
        o, q, i = at[right].T
        arm_o, arm_q = R[o, i] @ lever, R[q, i] @ lever
        v = p[q, i] + arm_q - p[o, i] - arm_o
        distance = np.linalg.norm(v, axis=1)[:, None, None]
        u = v[:, :, None] / distance
        by_observer, by_peer = -_turned(arm_o), _turned(arm_q)
        if lever is WIFI_BODY_M:
            # the direction is seen from the observer's body, which turns with it
            by_observer[..., 0] -= np.cross(_UP, v)
            across = (np.eye(3) - u @ np.swapaxes(u, 1, 2)) / distance / np.deg2rad(noise.bearing_deg)
        else:
            across = np.swapaxes(u, 1, 2) / noise.range_m
        J = np.zeros((len(o), across.shape[1], *p.shape[:2], 4))
        each = np.arange(len(o))
        J[each, :, o, i] = across @ by_observer
        J[each, :, q, i] = across @ by_peer
        rows.append(J.reshape(-1, *p.shape[:2], 4))
    return np.concatenate(rows)


def _from_start(p: Float[NDArray, "n 3"]) -> Float[NDArray, "n 4 4"]:
    """Motion of every pose of a robot with exact odometry by the (yaw, x, y, z) of its first."""
    moved = np.zeros((len(p), 4, 4))
    moved[:, 0, 0] = 1.0
    moved[:, 1:] = _turned(p - p[0])
    return moved


def _odometry_information(p: Float[NDArray, "n 3"], noise: Noise) -> Float[NDArray, "n 4 n 4"]:
    """Information of a robot's dead reckoning about its poses."""
    n, step = len(p), np.diff(p, axis=0)
    sigma = step_sigma(np.linalg.norm(step, axis=1), noise)
    k = np.arange(n - 1)
    J = np.zeros((n - 1, 4, n, 4))
    J[k, :, k + 1] = np.eye(4)
    J[k, :, k] = -np.eye(4)
    # a step is seen from the pose it starts at, which turns
    J[k, 1:, k, 0] = -np.cross(_UP, step)
    rows = J / np.concatenate([sigma[:, :1], np.repeat(sigma[:, 1:], 3, 1)], 1)[..., None, None]
    rows = rows.reshape(4 * (n - 1), 4 * n)
    return (rows.T @ rows).reshape(n, 4, n, 4)


def camera_bound(team: SimulatedTeam, noise: Noise, drifting: bool) -> Float[NDArray, "others photos"]:
    """Bound on the mean squared error [m²] of every camera position of all robots but the anchor.

    Freedoms are yaw and position of each start frame, or, where odometry drifts, of every pose; the anchor's
    first pose is fixed. The Fisher information is that of the right measurements at the truth.
    """
    T = team.T_truth_body
    R, p = T[..., :3, :3], T[..., :3, 3]
    robots, samples = p.shape[:2]
    J = _measured(team, noise)
    if drifting:
        J = J.reshape(len(J), -1)
        information = (J.T @ J).reshape(robots, samples, 4, robots, samples, 4)
        for k in range(robots):
            information[k, :, :, k] += _odometry_information(p[k], noise)
        size = robots * samples * 4
        covariance = np.zeros((size, size))
        covariance[4:, 4:] = np.linalg.inv(information.reshape(size, size)[4:, 4:])
        by_pose = covariance.reshape(robots, samples, 4, robots, samples, 4)
        own = by_pose[np.arange(robots)[:, None], team.photo_at, :, np.arange(robots)[:, None], team.photo_at]
    else:
        moved = np.array([_from_start(path) for path in p])
        J = np.einsum("mrsa,rsab->mrb", J, moved)[:, 1:].reshape(len(J), -1)
        covariance = np.zeros((4 * robots, 4 * robots))
        covariance[4:, 4:] = np.linalg.inv(J.T @ J)
        start = covariance.reshape(robots, 4, robots, 4)[np.arange(robots), :, np.arange(robots)]
        at = moved[:, team.photo_at]
        own = at @ start[:, None] @ np.swapaxes(at, 2, 3)
    arm = (R[:, team.photo_at] @ CAMERA_BODY_M).reshape(-1, 3)
    to_camera = _turned(arm).reshape(robots, -1, 3, 4)
    return np.einsum("rpia,rpab,rpib->rp", to_camera, own, to_camera)[1:]
