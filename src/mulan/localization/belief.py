"""How far measurements are to be believed: as right ones, as wrong ones, at given poses."""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from scipy.special import ndtr

from mulan.geometry import so3
from mulan.localization.measurement_terms import MeasurementTerms, Poses

_DETOUR_SPAN_M = 10.0  # wrong ranges are too long by up to so many metres
_NONSENSE = 0.1  # share of wrong ranges that may be too short as well


def log_likelihoods(
    terms: MeasurementTerms,
    poses: Poses,
    inflation: float,
    spread: Float[NDArray, "m 12 12"] | None = None,
) -> tuple[Float[NDArray, "m"], Float[NDArray, "m"], Int[NDArray, "b"]]:
    """Of each measurement as a right one (any hypothesis), as a wrong one, and the likeliest hypothesis.

    Args:
        terms: Measurements.
        poses: Where the robots are thought to be.
        inflation: Multiplies every sigma.
        spread: Joint covariance of the two poses of a measurement that is not in the estimate yet: it is
            judged against a prediction that is itself uncertain. Zeros for one that is.
    """
    b, mass = len(terms.direction), terms.outlier_mass
    v, from_body, R_o_p = terms.sight(poses)
    covariance = terms.covariance * inflation**2
    variance = (terms.sigma_m * inflation) ** 2
    if spread is not None:
        by_poses = np.concatenate(
            [
                so3.hat(from_body),
                np.tile(-np.eye(3), (len(v), 1, 1)),
                -R_o_p @ so3.hat(terms.peer_body_m),
                R_o_p,
            ],
            axis=2,
        )
        of_v = by_poses @ spread @ np.swapaxes(by_poses, 1, 2)
        length = np.maximum(np.linalg.norm(v, axis=1), 1e-9)
        across = of_v[:b] / length[:b, None, None] ** 2
        covariance = covariance + np.swapaxes(terms.basis, 2, 3) @ across[:, None] @ terms.basis
        variance = variance + np.einsum("ri,rij,rj->r", v[b:], of_v[b:], v[b:]) / length[b:] ** 2
    miss = terms.bearing_misses(v[:b])
    squared = (miss * np.linalg.solve(covariance, miss[..., None])[..., 0]).sum(-1)
    # an axis that was not observed has variance one and no miss: it adds nothing but must not be normalised
    unseen = (2 - terms.axes)[:, None] * 2 * np.log(inflation)
    log_volume = np.linalg.slogdet(covariance)[1] - unseen + terms.axes[:, None] * np.log(2 * np.pi)
    inside = terms.log_weight - squared / 2 - log_volume / 2
    too_long = -terms.range_misses(v[b:], poses) / np.sqrt(variance)
    right_range = np.log1p(-mass[b:]) - (too_long**2 + np.log(2 * np.pi * variance)) / 2
    log_right = np.concatenate([np.logaddexp.reduce(inside, axis=1), right_range])
    sphere = np.where(terms.axes == 1, 2 * np.pi, 4 * np.pi)
    # a detour makes a range longer; only nonsense makes it shorter
    detour = (1 - _NONSENSE) * ndtr(too_long) + _NONSENSE / 2
    wrong = np.concatenate([1 / sphere, detour / _DETOUR_SPAN_M])
    return log_right, np.log(np.maximum(mass, 1e-300)) + np.log(wrong), inside.argmax(1)


def belief(
    terms: MeasurementTerms,
    poses: Poses,
    inflation: float,
    spread: Float[NDArray, "m 12 12"] | None = None,
) -> tuple[Float[NDArray, "m"], Int[NDArray, "b"]]:
    """Posterior that each measurement (any hypothesis of a bearing) is right; the likeliest hypothesis.

    Arguments as ``log_likelihoods``.
    """
    log_right, log_wrong, chosen = log_likelihoods(terms, poses, inflation, spread)
    return np.exp(log_right - np.logaddexp(log_right, log_wrong)), chosen
