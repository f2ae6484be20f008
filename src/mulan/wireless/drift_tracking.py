"""Direction and odometry drift along an aperture, estimated together.

One percent of drift over a metre and a half of antenna path turns a 5 GHz round-trip phase by three radians:
the coherent sum then has the wrong peak. Here the drift is a random walk of known variance on the phase, and
direction and walk are found by generalised least squares (autofocus, as synthetic aperture radar calls it).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from mulan.wireless.directions import tangent_basis
from mulan.wireless.peak import SteeringModel

_SMOOTHING_PACKETS = 9
_STEPS = 12
_LONGEST_STEP_RAD = 0.2
_SAME_BASIN_RAD = 0.15
_DISTINCT_RAD = 0.03
_LEAST_STEP_RAD2 = 1e-6  # keeps the precision finite where the antenna rests
_LEVEL_ELEVATION_STEP_RAD = 0.3  # prior that lets a level path settle the size of the elevation, not its sign


@dataclass(frozen=True)
class TrackedDirection:
    """A direction with the phase drift that goes with it.

    Attributes:
        direction: Unit vector.
        covariance: Over ``tangent_basis(direction)`` [rad²].
        drift_rad: Phase drift of every packet, global phase included.
        cost: Squared residuals whitened by noise and drift; minus twice the log-likelihood up to a constant.
    """

    direction: Float[NDArray, "3"]
    covariance: Float[NDArray, "2 2"]
    drift_rad: Float[NDArray, "n"]
    cost: float


def _smoothed_phase(turned: Complex[NDArray, "n"]) -> Float[NDArray, "n"]:
    """Unwrapped phase of a short moving average, which turns little from packet to packet."""
    width = min(_SMOOTHING_PACKETS, len(turned) | 1)
    padded = np.pad(turned / np.maximum(np.abs(turned), 1e-12), width // 2, mode="reflect")
    return np.unwrap(np.angle(np.convolve(padded, np.ones(width), "valid")))


def packet_phase_variance(
    model: SteeringModel, channel: Complex[NDArray, "n"], direction: Float[NDArray, "3"]
) -> float:
    """Variance [rad²] of one packet's phase about its neighbours': noise without drift."""
    turned = model.turned_back(channel, direction)
    about = np.angle(turned * np.exp(-1j * _smoothed_phase(turned)))
    return max(float((about**2).mean()) * _SMOOTHING_PACKETS / (_SMOOTHING_PACKETS - 1), 1e-4)


class DriftTracker:
    """Generalised least squares for one aperture; the matrices are banded, so a step is linear in packets."""

    def __init__(
        self,
        model: SteeringModel,
        channel: Complex[NDArray, "n"],
        drift_variance_m2: Float[NDArray, "n"],
        phase_variance_rad2: float,
        level: bool = False,
    ) -> None:
        """Prepare.

        Args:
            model: Steering.
            channel: One complex number a packet.
            drift_variance_m2: Variance of the displacement towards the source since the first packet.
            phase_variance_rad2: Of one packet.
            level: The path is level: elevation is fitted only as far as its cosine needs it.
        """
        self._model, self._channel, self._level = model, channel, level
        self._phase_variance = phase_variance_rad2
        self._prior = np.diag([0.0, _LEVEL_ELEVATION_STEP_RAD**-2 if level else 0.0])
        # a random walk's precision is tridiagonal; leaving its level free also leaves the global phase free
        stiffness = 1 / np.maximum(np.diff(drift_variance_m2) * model.wavenumber_rad_m**2, _LEAST_STEP_RAD2)
        self._banded = np.zeros((2, len(channel)))
        self._banded[0, 1:] = -stiffness
        self._banded[1] = 1 / phase_variance_rad2
        self._banded[1, 1:] += stiffness
        self._banded[1, :-1] += stiffness

    def _smooth(self, phase: Float[NDArray, "n *p"]) -> Float[NDArray, "n *p"]:
        """The most probable drift behind measured phases."""
        return solveh_banded(self._banded, phase / self._phase_variance)

    def _whiten(self, phase: Float[NDArray, "n *p"]) -> Float[NDArray, "n *p"]:
        """Phases times the inverse covariance of noise plus drift (Woodbury)."""
        return (phase - self._smooth(phase)) / self._phase_variance

    def track(self, direction: Float[NDArray, "3"]) -> TrackedDirection:
        """The best direction near a start (within some 20 degrees) and its drift."""
        turned = self._model.turned_back(self._channel, direction)
        drift = _smoothed_phase(turned)
        for _ in range(_STEPS):
            measured = drift + np.angle(turned * np.exp(-1j * drift))
            J = self._model.jacobian(direction)
            whitened = self._whiten(J)
            step = np.linalg.solve(J.T @ whitened + self._prior, whitened.T @ measured)
            step = step * min(1.0, _LONGEST_STEP_RAD / max(float(np.linalg.norm(step)), 1e-12))
            drift = self._smooth(measured - J @ step)
            direction = direction + tangent_basis(direction) @ step
            direction = direction / np.linalg.norm(direction)
            turned = self._model.turned_back(self._channel, direction)
            if np.linalg.norm(step) < 1e-5:
                break
        measured = drift + np.angle(turned * np.exp(-1j * drift))
        cost = float(measured @ self._whiten(measured))
        J = self._model.jacobian(direction)
        covariance = np.linalg.inv(J.T @ self._whiten(J) + self._prior)
        # a model that fits worse than its own noise says so in its covariance
        covariance = covariance * max(1.0, cost / (len(measured) - 3))
        if self._level:
            covariance = np.array([[covariance[0, 0], 0.0], [0.0, np.inf]])
        return TrackedDirection(direction, covariance, drift, cost)


def tracked_peaks(
    model: SteeringModel,
    channel: Complex[NDArray, "n"],
    starts: Float[NDArray, "s 3"],
    drift_variance_m2: Float[NDArray, "n"],
    level: bool,
    count: int = 3,
) -> list[TrackedDirection]:
    """Distinct tracked directions, cheapest first.

    Args:
        model: Steering.
        channel: One complex number a packet.
        starts: Peaks of the profile, strongest first; those close to an earlier one share its basin.
        drift_variance_m2: As for ``DriftTracker``.
        level: As for ``DriftTracker``.
        count: How many to keep.
    """
    phase_variance = min(packet_phase_variance(model, channel, u) for u in starts[:4])
    tracker = DriftTracker(model, channel, drift_variance_m2, phase_variance, level)
    found: list[TrackedDirection] = []
    tried: list[Float[NDArray, "3"]] = []
    for start in starts:
        if any(start @ other > np.cos(_SAME_BASIN_RAD) for other in tried):
            continue
        result = tracker.track(start)
        tried += [start, result.direction]
        if all(result.direction @ other.direction < np.cos(_DISTINCT_RAD) for other in found):
            found.append(result)
    return sorted(found, key=lambda result: result.cost)[:count]


def tracked_weights(tracked: list[TrackedDirection]) -> Float[NDArray, "k"]:
    """Relative posterior probabilities of tracked directions: fit, tempered by its misfit, and peak area."""
    misfit = max(1.0, tracked[0].cost / max(len(tracked[0].drift_rad) - 3, 1))
    log_weight = np.array(
        [-0.5 * t.cost / misfit + 0.5 * np.log(t.covariance[0, 0]) for t in tracked]
    ) + np.array(
        [0.5 * np.log(t.covariance[1, 1]) if np.isfinite(t.covariance[1, 1]) else 0.0 for t in tracked]
    )
    weight = np.exp(log_weight - log_weight.max())
    return weight / weight.sum()
