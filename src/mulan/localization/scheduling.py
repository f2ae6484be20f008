"""When to take the next synthetic-aperture measurement, and between whom."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.factors import Sight, line_of_sight
from mulan.localization.online_estimate import OnlineEstimate
from mulan.wireless.directions import tangent_basis


@dataclass(frozen=True)
class SchedulingConfig:
    """What is worth an aperture: the observer moves its antenna, the peer answers and stands still."""

    position_goal_m: float = 0.15
    """A pair whose relative position is surer than this (one sigma, root of the summed variances) waits."""
    heading_goal_deg: float = 2.0
    """The same for the relative heading; a pair is due when either has grown past its goal."""
    least_gain_nats: float = 0.5
    """A measurement expected to tell less is put off until the covariance has grown."""
    sigma_deg: float = 5.0
    """Of the bearing an aperture will give, each axis."""
    sigma_m: float = 0.05
    """Of the range taken with it."""
    most: int = 1
    """Apertures that may run at once; each robot takes part in one."""


@dataclass(frozen=True)
class Appointment:
    """One aperture to take.

    Attributes:
        observer, peer: Who moves its antenna, and who answers.
        gain_nats: Information expected about all robots' poses.
        position_sigma_m, heading_sigma_rad: Of the pair's relative pose, before.
    """

    observer: str
    peer: str
    gain_nats: float
    position_sigma_m: float
    heading_sigma_rad: float


def _rows(
    estimate: OnlineEstimate, observer: str, peer: str, config: SchedulingConfig
) -> Float[NDArray, "3 n"]:
    """Whitened derivative of the expected bearing and range by all poses of the joint covariance."""
    zero = np.zeros(3)
    T_observer, T_peer = estimate.T_world_body[observer], estimate.T_world_body[peer]
    v, by_observer, by_peer = line_of_sight(T_observer, T_peer, Sight(0, 1, zero, zero))
    distance = max(float(np.linalg.norm(v)), 1e-3)
    u = v / distance
    by_v = np.vstack([tangent_basis(u).T / (distance * np.deg2rad(config.sigma_deg)), u / config.sigma_m])
    rows = np.zeros((3, len(estimate.joint_covariance)))
    for name, J in ((observer, by_observer), (peer, by_peer)):
        at = 6 * estimate.names.index(name)
        rows[:, at : at + 6] = by_v @ J
    return rows


def _relative_sigmas(
    estimate: OnlineEstimate, joint: Float[NDArray, "n n"], observer: str, peer: str
) -> tuple[float, float]:
    """Of the peer's position and heading as the observer sees them."""
    T_observer, T_peer = estimate.T_world_body[observer], estimate.T_world_body[peer]
    zero = np.zeros(3)
    _, by_observer, by_peer = line_of_sight(T_observer, T_peer, Sight(0, 1, zero, zero))
    up = np.concatenate([T_observer[2, :3], np.zeros(3), -T_peer[2, :3], np.zeros(3)])
    J = np.vstack([np.hstack([by_observer, by_peer]), up])
    at = np.concatenate([6 * estimate.names.index(name) + np.arange(6) for name in (observer, peer)])
    variance = np.diag(J @ joint[np.ix_(at, at)] @ J.T)
    return float(np.sqrt(variance[:3].sum())), float(np.sqrt(variance[3]))


def next_measurements(
    estimate: OnlineEstimate, config: SchedulingConfig, busy: Collection[str] = ()
) -> tuple[Appointment, ...]:
    """Apertures worth taking now, the most telling first; none while every pair is sure enough.

    The paper starts a new aperture when the odometry's covariance has grown; here the covariance of every
    pair's relative pose is watched, so that two robots tied through a third are not measured twice. Among the
    pairs that are due, the measurement expected to tell most is taken, and the covariance it would leave
    decides about the next.

    Args:
        estimate: After an update; only robots in ``estimate.names`` are considered.
        config: Goals.
        busy: Robots that cannot take part now.
    """
    joint = estimate.joint_covariance
    free = [name for name in estimate.names if name not in busy]
    chosen: list[Appointment] = []
    while len(chosen) < config.most:
        best: tuple[float, Appointment, NDArray] | None = None
        for observer in free:
            for peer in free:
                if observer == peer:
                    continue
                position, heading = _relative_sigmas(estimate, joint, observer, peer)
                if position < config.position_goal_m and heading < np.deg2rad(config.heading_goal_deg):
                    continue
                rows = _rows(estimate, observer, peer, config)
                gain = 0.5 * float(np.linalg.slogdet(np.eye(3) + rows @ joint @ rows.T)[1])
                if gain >= config.least_gain_nats and (best is None or gain > best[0]):
                    best = gain, Appointment(observer, peer, gain, position, heading), rows
        if best is None:
            break
        _, appointment, rows = best
        chosen.append(appointment)
        free = [name for name in free if name not in (appointment.observer, appointment.peer)]
        known = joint @ rows.T
        joint = joint - known @ np.linalg.solve(np.eye(3) + rows @ known, known.T)
    return tuple(chosen)
