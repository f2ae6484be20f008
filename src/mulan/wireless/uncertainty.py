"""How well one aperture knows its directions: covariance, hypothesis weights, outlier mass."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray
from scipy.special import i0e

from mulan.wireless.directions import direction_grid, unit_direction
from mulan.wireless.peak import SteeringModel

_PLANAR_PHASE_RAD = 1.0  # an off-plane spread that turns the phase less than this cannot tell up from down
_HORIZONTAL_NORMAL = 0.94  # the path's plane counts as horizontal within 20 degrees


@dataclass(frozen=True)
class ResidualStatistics:
    """What is left of a channel once a direction's phase is removed.

    Attributes:
        coherence: R₁, share of the amplitude that adds up, in 0..1.
        variance_rad2: ½(1-R₂)/R₁² generalised to unequal amplitudes: phase variance of one packet as the
            coherent sum feels it.
        correlation_packets: Integrated autocorrelation of the residual, at least 1: so many count as one.
    """

    coherence: float
    variance_rad2: float
    correlation_packets: float


def residual_statistics(
    model: SteeringModel, channel: Complex[NDArray, "n"], direction: Float[NDArray, "3"]
) -> ResidualStatistics:
    """Statistics of the residual phases about one direction."""
    turned = model.turned_back(channel, direction)
    in_phase = turned * np.exp(-1j * np.angle(turned.sum()))
    amplitude = np.abs(channel)
    mean_real = max(float(in_phase.real.mean()), 1e-9)
    # for unit amplitudes mean(sin²) = (1 - R₂)/2, mean(cos) = R₁; R₂ <= R₁ guards against π jumps of chips
    second = float((in_phase**2).real.mean() / (amplitude**2).mean())
    first = mean_real / float(amplitude.mean())
    squared = 0.5 * (1 - min(second, first)) * float((amplitude**2).mean())
    return ResidualStatistics(first, squared / mean_real**2, _integrated_autocorrelation(in_phase.imag))


def residual_smoothness(
    model: SteeringModel, channel: Complex[NDArray, "n"], direction: Float[NDArray, "3"]
) -> float:
    """Correlation of one packet's residual with the next one's: 0 for noise, towards 1 beside other paths."""
    turned = model.turned_back(channel, direction)
    residual = turned - turned.mean()
    power = float((np.abs(residual) ** 2).sum())
    return float((residual[1:] * residual[:-1].conj()).real.sum()) / max(power, 1e-30)


def _integrated_autocorrelation(score: Float[NDArray, "n"]) -> float:
    """1 + 2 Σρ up to the first small lag (initial positive sequence, Geyer 1992)."""
    n = len(score)
    spectrum = np.abs(np.fft.rfft(score - score.mean(), 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[: n // 4]
    if rho[0] <= 0:
        return 1.0
    rho = rho / rho[0]
    small = np.flatnonzero(rho[1:] < 3 / np.sqrt(n))
    last = small[0] if len(small) else len(rho) - 1
    return float(1 + 2 * rho[1 : 1 + last].sum())


def sandwich_covariance(
    model: SteeringModel,
    channel: Complex[NDArray, "n"],
    direction: Float[NDArray, "3"],
    drift_variance_m2: Float[NDArray, "n"] | None = None,
) -> Float[NDArray, "2 2"]:
    """Covariance [rad²] of a refined direction over ``tangent_basis``: ½(1-R₂)/R₁² (JᵀJ)⁻¹, global phase out.

    Errors that last over packets add to it: the larger of what the residual's autocorrelation shows and what
    the odometry's random walk along the path explains.

    Args:
        model: Steering.
        channel: One complex number a packet.
        direction: The refined unit vector.
        drift_variance_m2: Variance of the antenna's displacement towards the source since the first packet
            (non-decreasing), or None where the odometry gives none.

    Returns:
        The matrix; infinite in elevation where the path is level, because up and down look alike there.
    """
    statistics = residual_statistics(model, channel, direction)
    J = model.jacobian(direction)
    J = J - J.mean(0)
    level = is_level(model)
    if level:
        J = J[:, :1]
    gain = np.linalg.pinv(J, rcond=1e-9)
    white = statistics.variance_rad2 * gain @ gain.T
    lasting = (statistics.correlation_packets - 1) * white
    if drift_variance_m2 is not None:
        drift = _walk_covariance(gain, drift_variance_m2, model.wavenumber_rad_m)
        lasting = drift if np.trace(drift) > np.trace(lasting) else lasting
    covariance = white + lasting
    if level:
        return np.array([[covariance[0, 0], 0.0], [0.0, np.inf]])
    return covariance


def _walk_covariance(
    gain: Float[NDArray, "q n"], drift_variance_m2: Float[NDArray, "n"], wavenumber_rad_m: float
) -> Float[NDArray, "q q"]:
    """What a random walk of the antenna does to ``gain @ phase``."""
    # a random walk has covariance min(q_k, q_l), whose factor is a running sum of independent steps
    steps = np.sqrt(np.maximum(np.diff(drift_variance_m2, prepend=0.0), 0.0)) * wavenumber_rad_m
    tail = np.cumsum(gain[:, ::-1], axis=1)[:, ::-1] * steps
    return tail @ tail.T


def drift_covariance(
    model: SteeringModel, direction: Float[NDArray, "3"], drift_variance_m2: Float[NDArray, "n"]
) -> Float[NDArray, "2 2"]:
    """Part of a direction's covariance [rad²] that odometry drift causes; none in elevation on a level path.

    Args:
        model: Steering.
        direction: Unit vector.
        drift_variance_m2: As for ``sandwich_covariance``.
    """
    J = model.jacobian(direction)
    J = J - J.mean(0)
    if is_level(model):
        J = J[:, :1]
    covariance = np.zeros((2, 2))
    gain = np.linalg.pinv(J, rcond=1e-9)
    axes = J.shape[1]
    covariance[:axes, :axes] = _walk_covariance(gain, drift_variance_m2, model.wavenumber_rad_m)
    return covariance


def path_normal_and_spread(model: SteeringModel) -> tuple[Float[NDArray, "3"], Float[NDArray, "3"]]:
    """Normal of the path's best plane, and its RMS spread [m] along the principal axes, largest first."""
    _, singular, Vt = np.linalg.svd(model.relative_m, full_matrices=False)
    return Vt[2], singular / np.sqrt(len(model.relative_m))


def is_level(model: SteeringModel) -> bool:
    """Whether the path is a horizontal plane as far as the radio can tell: elevation is then unobservable."""
    normal, spread = path_normal_and_spread(model)
    return bool(
        spread[2] * model.wavenumber_rad_m < _PLANAR_PHASE_RAD and abs(normal[2]) > _HORIZONTAL_NORMAL
    )


def is_straight(model: SteeringModel) -> bool:
    """Whether the path is a line as far as the radio can tell: only a cone of directions then shows."""
    _, spread = path_normal_and_spread(model)
    return bool(spread[1] * model.wavenumber_rad_m < _PLANAR_PHASE_RAD)


def hypothesis_weights(
    model: SteeringModel,
    channel: Complex[NDArray, "n"],
    power: Float[NDArray, "e a"],
    directions: Float[NDArray, "k 3"],
    least_outlier_mass: float = 0.01,
) -> tuple[Float[NDArray, "k"], float]:
    """Posterior probability of each direction and of none of them.

    Phases with von Mises noise of concentration κ and a free global phase give the posterior
    ``p(u) ∝ I₀(κ |Σ h exp(-jφ(u))|)``; each hypothesis holds the mass of its own peak (Laplace), the grid
    outside the peaks is the outlier mass. Correlated residuals temper the exponent.

    Returns:
        Weights that sum with the outlier mass to one, and the outlier mass (at least the floor).
    """
    statistics = [residual_statistics(model, channel, u) for u in directions]
    R = min(max(s.coherence for s in statistics), 0.9999)
    amplitude = float(np.abs(channel).mean())
    # Best & Fisher (1981) style inverse of I₁/I₀, good to a few percent
    concentration = R * (2 - R**2) / (1 - R**2) / min(s.correlation_packets for s in statistics)
    exponent = concentration / amplitude

    J = [model.jacobian(u) for u in directions]
    heights = np.array([exponent * np.abs(model.turned_back(channel, u).sum()) for u in directions])
    information = [concentration * R * (j - j.mean(0)).T @ (j - j.mean(0)) for j in J]
    peak_area = np.array([0.5 * np.linalg.slogdet(m + np.eye(2))[1] for m in information])
    log_peak = heights + np.log(i0e(heights)) + np.log(2 * np.pi) - peak_area

    azimuth_rad, elevation_rad = direction_grid(power.shape[1], power.shape[0])
    cell = (azimuth_rad[1] - azimuth_rad[0]) * (elevation_rad[1] - elevation_rad[0])
    x = exponent * np.sqrt(np.maximum(power, 0.0)).astype(float)
    log_cell = x + np.log(i0e(x)) + np.log(cell * np.maximum(np.cos(elevation_rad), 1e-9))[:, None]
    u = unit_direction(*np.meshgrid(azimuth_rad, elevation_rad))
    elsewhere = np.ones(power.shape, bool)
    beam_rad = max(4.0 / (model.wavenumber_rad_m * float(path_normal_and_spread(model)[1][1])), 0.05)
    kept_out = directions
    if is_level(model):
        kept_out = np.concatenate([directions, directions * [1.0, 1.0, -1.0]])
        beam_rad *= 3  # a level path sees elevation only through its cosine
    for direction in kept_out:
        elsewhere &= u @ direction < np.cos(beam_rad)
    log_rest = float(np.logaddexp.reduce(log_cell[elsewhere])) if elsewhere.any() else -np.inf
    total = float(np.logaddexp.reduce(np.append(log_peak, log_rest)))
    outlier_mass = max(float(np.exp(log_rest - total)), least_outlier_mass)
    share = np.exp(log_peak - np.logaddexp.reduce(log_peak))
    return share * (1 - outlier_mass), outlier_mass
