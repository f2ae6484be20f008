"""A robot's start frame from bearings and ranges: many starts solved at once, robustly, ranked by cost."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import so3
from mulan.localization.relative_measurements import RelativeMeasurements, SightLines

_STEP = 1e-6
_ANNEALING = (64.0, 64.0, 64.0, 16.0, 16.0, 16.0, 4.0, 4.0, 4.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
_PRUNED_AFTER = 3  # by then the hopeless starts show


@dataclass(frozen=True)
class Alignment:
    """Start frames tried, best first.

    Attributes:
        R, t_m: ``T_world_odom`` of every start after convergence.
        cost: Robust cost.
        information: Of the best, over (rotation about world axes, translation); in 4 DoF about z only.
    """

    R: Float[NDArray, "s 3 3"]
    t_m: Float[NDArray, "s 3"]
    cost: Float[NDArray, "s"]
    information: Float[NDArray, "d d"]


def _miss(v: Float[NDArray, "s m 3"], lines: SightLines) -> Float[NDArray, "s m 2"]:
    """Whitened chordal miss of the direction of v, of length 2 sin(θ/2) before whitening."""
    u = v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)
    half_cos2 = np.maximum((1 + (u * lines.direction).sum(-1)) / 2, 1e-6)
    return (lines.whitener @ u[..., None])[..., 0] / np.sqrt(half_cos2)[..., None]


def _residuals(
    R: Float[NDArray, "s 3 3"], t: Float[NDArray, "s 3"], m: RelativeMeasurements
) -> Float[NDArray, "s m 2"]:
    """Whitened residuals; ranges and the floor fill only the first column."""
    R_t = np.swapaxes(R, 1, 2)
    seen = m.seen.target_m @ R_t + t[:, None] - m.seen.origin_m
    sees = (m.sees.target_m[None] - t[:, None]) @ R - m.sees.origin_m
    apart = m.antenna_odom_m @ R_t + t[:, None] - m.antenna_world_m
    scalar = (np.linalg.norm(apart, axis=-1) - m.range_m) / m.range_sigma_m
    if m.floor_sigma_m is not None:
        height = (t[:, 2:] + m.floor_odom_m - m.floor_world_m) / m.floor_sigma_m
        scalar = np.concatenate([scalar, height], axis=1)
    return np.concatenate(
        [_miss(seen, m.seen), _miss(sees, m.sees), np.stack([scalar, np.zeros_like(scalar)], -1)], axis=1
    )


def _perturbed(
    R: Float[NDArray, "s 3 3"], t: Float[NDArray, "s 3"], delta: Float[NDArray, "s d"]
) -> tuple[Float[NDArray, "s 3 3"], Float[NDArray, "s 3"]]:
    """Rotate about world axes (only z in 4 DoF) and shift."""
    turn = np.zeros((len(delta), 3))
    free = delta.shape[1] - 3
    turn[:, 3 - free :] = delta[:, :free]
    return so3.exp(turn) @ R, t + delta[:, free:]


def _linearised(
    R: Float[NDArray, "s 3 3"], t: Float[NDArray, "s 3"], m: RelativeMeasurements, freedoms: int
) -> tuple[Float[NDArray, "s m 2"], Float[NDArray, "s m 2 d"]]:
    residual = _residuals(R, t, m)
    J = np.empty((*residual.shape, freedoms))
    for axis in range(freedoms):
        delta = np.zeros((len(R), freedoms))
        delta[:, axis] = _STEP
        J[..., axis] = (_residuals(*_perturbed(R, t, delta), m) - residual) / _STEP
    return residual, J


def _robust_cost(residual: Float[NDArray, "s m 2"], scale2: float) -> Float[NDArray, "s"]:
    """Geman-McClure: each measurement costs at most ``scale2``."""
    squared = (residual**2).sum(-1)
    return (scale2 * squared / (scale2 + squared)).sum(-1)


def search_alignment(
    m: RelativeMeasurements,
    R: Float[NDArray, "s 3 3"],
    t: Float[NDArray, "s 3"],
    freedoms: int = 4,
    outlier_sigmas: float = 3.0,
) -> Alignment:
    """Damped Gauss-Newton from all starts together, with an annealed redescending kernel.

    Args:
        m: Measurements.
        R: Start rotations.
        t: Start positions [m].
        freedoms: 4 (yaw, translation) or 6.
        outlier_sigmas: Scale of the kernel once annealed.
    """
    damping = np.full(len(R), 1e-3)
    for iteration, anneal in enumerate(_ANNEALING):
        scale2 = anneal * outlier_sigmas**2
        if iteration == _PRUNED_AFTER:
            kept = np.argsort(_robust_cost(_residuals(R, t, m), scale2), kind="stable")[: max(8, len(R) // 6)]
            R, t, damping = R[kept], t[kept], damping[kept]
        residual, J = _linearised(R, t, m, freedoms)
        weight = (scale2 / (scale2 + (residual**2).sum(-1))) ** 2
        H, g = _normal_equations(J, residual, weight)
        scale = np.einsum("sdd->sd", H) + 1e-3
        step = -np.linalg.solve(H + (damping[:, None] * scale)[..., None] * np.eye(freedoms), g[..., None])[
            ..., 0
        ]
        R_new, t_new = _perturbed(R, t, step)
        better = _robust_cost(_residuals(R_new, t_new, m), scale2) <= _robust_cost(residual, scale2)
        R, t = np.where(better[:, None, None], R_new, R), np.where(better[:, None], t_new, t)
        damping = np.where(better, damping / 5, damping * 10)
    scale2 = outlier_sigmas**2
    cost = _robust_cost(_residuals(R, t, m), scale2)
    order = np.argsort(cost, kind="stable")
    R, t, cost = R[order], t[order], cost[order]
    residual, J = _linearised(R[:1], t[:1], m, freedoms)
    weight = (scale2 / (scale2 + (residual**2).sum(-1))) ** 2
    return Alignment(R, t, cost, _normal_equations(J, residual, weight)[0][0])


def _normal_equations(
    J: Float[NDArray, "s m 2 d"], residual: Float[NDArray, "s m 2"], weight: Float[NDArray, "s m"]
) -> tuple[Float[NDArray, "s d d"], Float[NDArray, "s d"]]:
    starts, _, _, freedoms = J.shape
    rows = J.reshape(starts, -1, freedoms)
    weighted = np.swapaxes((J * weight[..., None, None]).reshape(starts, -1, freedoms), 1, 2)
    return weighted @ rows, (weighted @ residual.reshape(starts, -1, 1))[..., 0]
