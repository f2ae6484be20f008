"""Several paths of one aperture, found together: greedy start, joint refinement, order by BIC.

The channel of one direction is a sum of paths ``s = Σ a_i exp(jψ_i)``. The product of forward and reverse
channel is its square, ``s²``: beside each path at its round-trip phase it holds cross terms at the mean
phases of every pair, which look like paths that are not there. So the square of the sum is fitted
(``SQUARED``); the plain sum of round-trip paths (``SUM``) is kept to compare with and for one-way channels.
Several sets of paths are pursued side by side (a beam search), for a wrong first path is never left by
descent; all are refined in one batch.

After RELAX (Li and Stoica, IEEE Trans. Signal Processing 44(2), 1996).
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.directions import tangent_basis
from mulan.wireless.peak import SteeringModel
from mulan.wireless.uncertainty import is_level

_DIRECTIONS = 6000  # spread evenly over the sphere, under three degrees apart
_APART = np.cos(0.06)  # starts closer than this are one
_PARAMETERS_A_PATH = 4
_TRIAL_STEPS, _STEPS, _LAST_STEPS = 4, 15, 20
_LONGEST_STEP_RAD = 0.05


class PathSum(Enum):
    """What of the paths the channel holds."""

    SQUARED = "squared"
    SUM = "sum"


@dataclass(frozen=True)
class MultipathConfig:
    """How paths are resolved."""

    most_paths: int = 5
    """Paths tried, at most."""
    starts: int = 4
    """Peaks of the remainder tried as the next path."""
    beams: int = 6
    """Sets of paths pursued side by side; a wrong first path then does no lasting harm."""
    path_sum: PathSum = PathSum.SQUARED
    """The channel is the square of the sum of paths (round trip), or the sum itself."""
    power_exponent: float = 1.0
    """Probability that a path is the direct one goes as its power to this exponent."""
    missed_mass: float = 0.02
    """Probability that no path is the direct one."""
    weight_floor: float = 0.002
    """Least probability of a path."""


@dataclass(frozen=True)
class ResolvedPaths:
    """Paths of one aperture, strongest first.

    Attributes:
        direction: Unit vectors.
        power: One-way power |a|² of each path, the strongest is one.
        covariance: Over ``tangent_basis`` of each direction [rad²], with the other paths and all gains
            unknown too; infinite in elevation on a level path.
        weight: Probability that the path is the direct one; with ``outlier_mass`` they sum to one.
        outlier_mass: Probability that none is.
        explained: Share of the channel's energy the paths explain.
    """

    direction: Float[NDArray, "k 3"]
    power: Float[NDArray, "k"]
    covariance: Float[NDArray, "k 2 2"]
    weight: Float[NDArray, "k"]
    outlier_mass: float
    explained: float


@dataclass(frozen=True)
class _Fits:
    """B sets of K paths each."""

    direction: Float[NDArray, "b k 3"]
    gain: Complex[NDArray, "b k"]
    residual: Complex[NDArray, "b n"]
    cost: Float[NDArray, "b"]

    def taken(self, rows: NDArray) -> "_Fits":
        return _Fits(self.direction[rows], self.gain[rows], self.residual[rows], self.cost[rows])


def _even_directions(count: int) -> Float[NDArray, "g 3"]:
    """Fibonacci sphere."""
    number = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * number / count, np.pi * (1 + np.sqrt(5)) * number
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(azimuth), ring * np.sin(azimuth), z], -1)


class _Problem:
    """Least squares of one channel by sets of paths."""

    def __init__(self, model: SteeringModel, channel: Complex[NDArray, "n"], config: MultipathConfig) -> None:
        self.model, self.channel = model, channel
        self.level = is_level(model)
        self.squared = config.path_sum is PathSum.SQUARED
        self.share = 0.5 if self.squared else 1.0
        self.starts = config.starts
        directions = _even_directions(_DIRECTIONS)
        self.grid = directions[directions[:, 2] >= 0] if self.level else directions
        self.conj_waves = np.exp((-1j * self.share * self._phase(self.grid)).astype(np.complex64))  # [g, n]

    def _phase(self, direction: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b n"]:
        """``SteeringModel.phase_rad`` of many directions."""
        model = self.model
        projected = direction @ model.relative_m.T
        if model.range_m is None:
            return model.wavenumber_rad_m * projected
        r, square = model.range_m, (model.relative_m**2).sum(1)
        return model.wavenumber_rad_m * (r - np.sqrt(r**2 - 2 * r * projected + square))

    def _slope(self, direction: Float[NDArray, "*b 3"]) -> Float[NDArray, "*b 2 n"]:
        """``SteeringModel.jacobian`` of many directions."""
        model = self.model
        slope = model.wavenumber_rad_m * np.swapaxes(tangent_basis(direction), -1, -2) @ model.relative_m.T
        if model.range_m is None:
            return slope
        distance = model.range_m - self._phase(direction) / model.wavenumber_rad_m
        return slope * (model.range_m / distance)[..., None, :]

    def fits(self, direction: Float[NDArray, "b k 3"], gain: Complex[NDArray, "b k"]) -> _Fits:
        """Residual and cost of given paths."""
        total = (np.exp(1j * self.share * self._phase(direction)) * gain[..., None]).sum(1)
        residual = self.channel - (total**2 if self.squared else total)
        return _Fits(direction, gain, residual, (np.abs(residual) ** 2).sum(1))

    def jacobian(self, fits: _Fits) -> Complex[NDArray, "b q n"]:
        """Derivatives by (Re a, Im a, azimuth, elevation) of each path in turn."""
        waves = np.exp(1j * self.share * self._phase(fits.direction))
        if self.squared:
            waves = waves * (2 * (waves * fits.gain[..., None]).sum(1, keepdims=True))
        turning = (1j * self.share * fits.gain[..., None] * waves)[:, :, None] * self._slope(fits.direction)
        columns = np.concatenate([waves[:, :, None], 1j * waves[:, :, None], turning], 2)
        return columns.reshape(len(columns), -1, columns.shape[-1])

    def refine(self, fits: _Fits, steps: int) -> _Fits:
        """Levenberg–Marquardt over all directions and gains, every set on its own."""
        damping = np.full(len(fits.cost), 1e-3)
        for _ in range(steps):
            J = self.jacobian(fits)
            conj = J.conj()
            H = np.real(conj @ np.swapaxes(J, 1, 2))
            gradient = np.real(conj @ fits.residual[:, :, None])
            scale = np.maximum(np.diagonal(H, axis1=1, axis2=2), 1e-6 * H.max((1, 2))[:, None])
            damped = H + (damping[:, None] * scale)[:, :, None] * np.eye(H.shape[1])
            step = np.linalg.solve(damped, gradient)[..., 0].reshape(len(H), -1, _PARAMETERS_A_PATH)
            longest = np.maximum(np.abs(step[..., 2:]).max((1, 2)), 1e-12)
            turn = step[..., 2:] * np.minimum(1.0, _LONGEST_STEP_RAD / longest)[:, None, None]
            moved = fits.direction + np.einsum("bkij,bkj->bki", tangent_basis(fits.direction), turn)
            moved /= np.linalg.norm(moved, axis=-1, keepdims=True)
            tried = self.fits(moved, fits.gain + step[..., 0] + 1j * step[..., 1])
            better = tried.cost < fits.cost
            gained = 1 - tried.cost / fits.cost
            damping = np.where(better, np.maximum(damping / 10, 1e-7), damping * 10)
            fits = _Fits(
                np.where(better[:, None, None], tried.direction, fits.direction),
                np.where(better[:, None], tried.gain, fits.gain),
                np.where(better[:, None], tried.residual, fits.residual),
                np.where(better, tried.cost, fits.cost),
            )
            if not np.any((better & (gained > 1e-5)) | (~better & (damping < 1e3))):
                break
        return fits

    def first(self) -> _Fits:
        """One path each, at the strongest directions of the channel itself."""
        waves = self.conj_waves**2 if self.squared else self.conj_waves
        amplitude = waves @ self.channel.astype(np.complex64) / len(self.channel)
        rows = self._apart(np.abs(amplitude), 2 * self.starts)
        gain = np.sqrt(amplitude[rows].astype(complex)) if self.squared else amplitude[rows].astype(complex)
        return self.fits(self.grid[rows][:, None], gain[:, None])

    def grown(self, fits: _Fits) -> _Fits:
        """Each set with one more path, at each of the strongest directions of what it leaves."""
        residual = fits.residual
        energy = np.ones(len(residual))
        if self.squared:
            waves = np.exp(1j * self.share * self._phase(fits.direction))
            outer = 2 * (waves * fits.gain[..., None]).sum(1)
            residual, energy = outer.conj() * residual, (np.abs(outer) ** 2).mean(1)
        amplitude = residual.astype(np.complex64) @ self.conj_waves.T / residual.shape[1] / energy[:, None]
        directions, gains = [], []
        for number, row in enumerate(amplitude):
            for found in self._apart(np.abs(row), self.starts):
                directions.append(np.vstack([fits.direction[number], self.grid[found]]))
                gains.append(np.append(fits.gain[number], row[found]))
        return self.fits(np.array(directions), np.array(gains))

    def _apart(self, height: Float[NDArray, "g"], count: int) -> NDArray:
        """The highest directions that are not neighbours."""
        height, rows = height.copy(), []
        for _ in range(count):
            rows.append(int(height.argmax()))
            height[self.grid @ self.grid[rows[-1]] > _APART] = -1
        return np.array(rows)

    def covariance(self, fits: _Fits) -> Float[NDArray, "k 2 2"]:
        """Blocks of the first set's inverse joint Fisher information, with the noise the residual shows."""
        J = self.jacobian(fits)[0]
        keep = np.ones(len(J), bool)
        if self.level:
            keep[3::_PARAMETERS_A_PATH] = False
        noise = fits.cost[0] / max(2 * J.shape[1] - int(keep.sum()), 1)
        information = (J.conj() @ J.T).real[np.ix_(keep, keep)]
        full = np.zeros((len(J), len(J)))
        full[np.ix_(keep, keep)] = noise * np.linalg.pinv(information, hermitian=True)
        blocks = np.stack([full[i : i + 2, i : i + 2] for i in range(2, len(J), _PARAMETERS_A_PATH)])
        if self.level:
            blocks[:, 1, 1] = np.inf
        return blocks


def _distinct(fits: _Fits, count: int) -> _Fits:
    """The cheapest sets that are not one and the same."""
    rows: list[int] = []
    for row in np.argsort(fits.cost, kind="stable"):
        if len(rows) < count and all(abs(fits.cost[row] / fits.cost[other] - 1) > 1e-3 for other in rows):
            rows.append(int(row))
    return fits.taken(np.array(rows))


def _middle_of_band(channel: Complex[NDArray, "n s"]) -> Complex[NDArray, "n"]:
    third = channel.shape[1] // 3
    return channel[:, third : channel.shape[1] - third].mean(1)


def resolve_paths(
    model: SteeringModel, channel: Complex[NDArray, "n *s"], config: MultipathConfig | None = None
) -> ResolvedPaths:
    """The paths of one aperture.

    Args:
        model: Steering along the antenna path, with the wavenumber of the channel.
        channel: One complex number a packet with its amplitude; of several columns (subcarriers)
            the middle third is averaged: over a whole band the mean of squares is no square.
        config: Options.
    """
    config = config or MultipathConfig()
    centre = channel if channel.ndim == 1 else _middle_of_band(channel)
    problem = _Problem(model, centre / np.sqrt(np.mean(np.abs(centre) ** 2)), config)
    n = len(centre)
    fits = problem.refine(problem.first(), _TRIAL_STEPS)
    chosen, least = fits, np.inf
    for count in range(1, config.most_paths + 1):
        if count > 1:
            fits = problem.refine(problem.grown(fits), _TRIAL_STEPS)
        fits = problem.refine(_distinct(fits, config.beams), _STEPS)
        best = problem.refine(fits.taken(np.array([fits.cost.argmin()])), _LAST_STEPS)
        bic = 2 * n * np.log(max(best.cost[0], 1e-12)) + _PARAMETERS_A_PATH * count * np.log(2 * n)
        if bic < least:
            chosen, least = best, bic
        elif count > chosen.gain.shape[1] + 1:
            break
    power = np.abs(chosen.gain[0]) ** (2 if problem.squared else 1)
    order = np.argsort(-power, kind="stable")
    power = power[order] / power[order[0]]
    weight = np.maximum(power**config.power_exponent, config.weight_floor)
    return ResolvedPaths(
        chosen.direction[0][order],
        power,
        problem.covariance(chosen)[order],
        weight / weight.sum() * (1 - config.missed_mass),
        config.missed_mass,
        float(1 - chosen.cost[0] / n),
    )
