"""The strongest directions of a profile, refined far below the grid spacing."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.wireless.directions import direction_grid, tangent_basis, unit_direction
from mulan.wireless.profile import wavenumber_rad_m

_LONGEST_STEP_RAD = 0.02  # about a beam width of a half-metre aperture at 5 GHz
_STEPS = 25
_LEAST_GAIN = 1e-11  # of the height: what is left is some millionth of a beam


@dataclass(frozen=True)
class SteeringModel:
    """Phase of a channel along an antenna path as a function of the source direction.

    Attributes:
        relative_m: Antenna positions about their centroid, to which the direction refers.
        wavenumber_rad_m: 4π/λ for round-trip channels, 2π/λ for one-way.
        range_m: Distance of the source from the centroid for spherical waves, or None for plane waves.
    """

    relative_m: Float[NDArray, "n 3"]
    wavenumber_rad_m: float
    range_m: float | None = None

    def phase_rad(self, direction: Float[NDArray, "3"]) -> Float[NDArray, "n"]:
        """Phase relative to the centroid: ``k p·u``, or ``k (r - |r u - p|)`` for spherical waves."""
        if self.range_m is None:
            return self.wavenumber_rad_m * (self.relative_m @ direction)
        distance = np.linalg.norm(self.range_m * direction - self.relative_m, axis=1)
        return self.wavenumber_rad_m * (self.range_m - distance)

    def jacobian(self, direction: Float[NDArray, "3"]) -> Float[NDArray, "n 2"]:
        """Derivative of the phase along ``tangent_basis(direction)``."""
        slope = self.relative_m @ tangent_basis(direction) * self.wavenumber_rad_m
        if self.range_m is None:
            return slope
        distance = np.linalg.norm(self.range_m * direction - self.relative_m, axis=1)
        return slope * (self.range_m / distance)[:, None]

    def turned_back(
        self, channel: Complex[NDArray, "n"], direction: Float[NDArray, "3"]
    ) -> Complex[NDArray, "n"]:
        """The channel with the phase of a direction removed; its sum is the beamformer output."""
        return channel * np.exp(-1j * self.phase_rad(direction))


def steering_model(
    position_m: Float[NDArray, "n 3"],
    wavelength_m: float,
    range_m: float | None = None,
    round_trip: bool = True,
) -> SteeringModel:
    """The steering model of an antenna path; directions refer to its centroid."""
    relative = position_m - position_m.mean(0)
    if range_m is not None and range_m < 2 * np.linalg.norm(relative, axis=1).max():
        range_m = None  # a source inside the aperture has no direction
    return SteeringModel(relative, wavenumber_rad_m(wavelength_m, round_trip), range_m)


def grid_peaks(power: Float[NDArray, "e a"], count: int, least_share: float) -> Float[NDArray, "p 3"]:
    """Unit vectors of the local maxima, strongest first.

    Args:
        power: On a full ``direction_grid``; azimuth wraps.
        count: At most so many.
        least_share: Ignore maxima below this share of the highest.
    """
    azimuth_rad, elevation_rad = direction_grid(power.shape[1], power.shape[0])
    padded = np.pad(power, ((0, 0), (1, 1)), mode="wrap")
    padded = np.pad(padded, ((1, 1), (0, 0)), constant_values=-np.inf)
    rows, columns = power.shape
    neighbours = [
        padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if i or j
    ]
    highest = power.max()
    row, column = np.nonzero((power >= np.max(neighbours, axis=0)) & (power >= least_share * highest))
    order = np.argsort(-power[row, column], kind="stable")[:count]
    return unit_direction(azimuth_rad[column[order]], elevation_rad[row[order]])


def refine_direction(
    model: SteeringModel, channel: Complex[NDArray, "n"], direction: Float[NDArray, "3"]
) -> Float[NDArray, "3"]:
    """Climb to the maximum of ``|Σ h exp(-jφ(u))|`` by damped Gauss-Newton on the sphere."""
    damping = 1e-3
    turned = model.turned_back(channel, direction)
    height = np.abs(turned.sum())
    for _ in range(_STEPS):
        in_phase = turned * np.exp(-1j * np.angle(turned.sum()))
        J = model.jacobian(direction)
        J = J - J.mean(0)
        gradient = J.T @ in_phase.imag
        curvature = max(in_phase.real.mean(), 0.05 * np.abs(channel).mean()) * (J.T @ J)
        # the largest diagonal term keeps an unobservable axis from taking wild steps
        damped = curvature + damping * curvature.diagonal().max() * np.eye(2)
        step = np.linalg.solve(damped, gradient)
        step *= min(1.0, _LONGEST_STEP_RAD / max(float(np.linalg.norm(step)), 1e-12))
        candidate = direction + tangent_basis(direction) @ step
        candidate = candidate / np.linalg.norm(candidate)
        turned_candidate = model.turned_back(channel, candidate)
        height_candidate = np.abs(turned_candidate.sum())
        if height_candidate > height:
            settled = height_candidate - height < _LEAST_GAIN * height
            direction, turned, height = candidate, turned_candidate, height_candidate
            damping = max(damping / 5, 1e-6)
            if settled:
                break
        else:
            damping *= 10
        if np.linalg.norm(step) < 1e-7 or damping > 1e6:
            break
    return direction


def refined_peaks(
    model: SteeringModel,
    channel: Complex[NDArray, "n"],
    power: Float[NDArray, "e a"],
    count: int = 3,
    least_share: float = 0.2,
    apart_rad: float = 0.03,
) -> Float[NDArray, "k 3"]:
    """The distinct refined maxima, strongest first.

    Args:
        model: Steering along the antenna path.
        channel: One complex number a packet.
        power: The plane-wave profile on a full grid, used only to start.
        count: How many to keep.
        least_share: Ignore grid maxima below this share of the highest power.
        apart_rad: Closer maxima are one.
    """
    found: list[tuple[float, Float[NDArray, "3"]]] = []
    for start in grid_peaks(power, 3 * count, least_share):
        direction = refine_direction(model, channel, start)
        if all(np.linalg.norm(direction - other) > apart_rad for _, other in found):
            found.append((float(np.abs(model.turned_back(channel, direction).sum())), direction))
    found.sort(key=lambda entry: -entry[0])
    return np.array([direction for _, direction in found[:count]])
