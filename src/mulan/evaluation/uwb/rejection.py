"""Gross outliers found without truth: one antenna pair against the other 35 of the same two agents."""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.uwb.score import link_numbers
from mulan.wireless.range_model import RangeModel
from mulan.wireless.recordings.uwb_samples import RangeSamples

GROSS_M = 1.0
"""An error beyond this is a gross outlier."""
DETOUR_M = 0.7
"""Rejected is what probably took a detour beyond this."""
REJECT_ABOVE = 0.5
"""Outlier probability above which a range is left out."""
PREDICTION_SIGMA_M = 0.05
"""What the additive form leaves of true distances (near field), and of the fit."""
_ANTENNA_SIGMA_M = 0.3  # an antenna's place along the line of sight, from the agent's centre
_NOISE_M, _ROUNDS = 0.1, 60


def consensus_m(model: RangeModel, samples: RangeSamples) -> Float[NDArray, "n"]:
    """Distance of each antenna pair as the other antennas of the same instant tell it.

    Seen from afar, distances of antennas i and j are additive, D + a_i + b_j. The sum is fitted to all pairs,
    each freed of its bias, by reweighted least squares with Cauchy weights: no truth, no array geometry.
    """
    distance = model.distance_m(link_numbers(model, samples), samples.range_m)
    firsts, seconds = (sorted({link[k] for link in samples.links}) for k in (0, 1))
    columns = 1 + len(firsts) + len(seconds)
    design = np.zeros((len(samples.links), columns))
    design[:, 0] = 1
    for row, (first, second) in enumerate(samples.links):
        design[row, [1 + firsts.index(first), 1 + len(firsts) + seconds.index(second)]] = 1
    ridge = np.diag(np.r_[0.0, np.full(columns - 1, (_NOISE_M / _ANTENNA_SIGMA_M) ** 2)])
    predicted = np.empty(len(distance))
    for instant in np.unique(samples.time_s):
        rows = np.flatnonzero(samples.time_s == instant)
        A, z = design[samples.link[rows]], distance[rows]
        residual = z - np.median(z)
        for _ in range(_ROUNDS):
            weight = 1 / (1 + (residual / _NOISE_M) ** 2)
            residual = z - A @ np.linalg.solve(A.T * weight @ A + ridge, A.T * weight @ z)
        predicted[rows] = z - residual
    return predicted


def reject(model: RangeModel, samples: RangeSamples) -> Float[NDArray, "n"]:
    """Outlier probability of each range of one pair of agents, given the consensus of all antennas."""
    return model.outlier_probability(
        link_numbers(model, samples),
        samples.range_m,
        consensus_m(model, samples),
        PREDICTION_SIGMA_M,
        DETOUR_M,
    )


def rejection(model: RangeModel, samples: RangeSamples) -> dict[str, Any]:
    """Precision and recall of the rejection against errors beyond ``GROSS_M``, and what rejecting leaves."""
    probability = reject(model, samples)
    out, gross = probability > REJECT_ABOVE, np.abs(samples.error_m) > GROSS_M
    hit = int((out & gross).sum())
    kept = samples.error_m[~out]
    nll = -model.log_density(link_numbers(model, samples), samples.range_m, samples.true_range_m)
    return {
        "gross_beyond_m": GROSS_M,
        "ranges": len(out),
        "gross": int(gross.sum()),
        "rejected": int(out.sum()),
        "rejected_beyond_half_metre": int((out & (np.abs(samples.error_m) > GROSS_M / 2)).sum()),
        "precision": hit / int(out.sum()) if out.any() else None,
        "recall": hit / int(gross.sum()) if gross.any() else None,
        "largest_kept_error_m": float(np.abs(kept).max()),
        "rms_before_m": float(np.sqrt(np.mean(samples.error_m**2))),
        "rms_after_m": float(np.sqrt(np.mean(kept**2))),
        "nll_all": float(nll.mean()),
        "nll_gross": float(nll[gross].mean()) if gross.any() else None,
        "nll_kept": float(nll[~out].mean()),
    }
