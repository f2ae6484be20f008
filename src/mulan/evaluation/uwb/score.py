"""Negative log-likelihood and coverage of range models on held-out ranges."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.special import ndtr

from mulan.wireless.range_model import RangeModel
from mulan.wireless.recordings.uwb_samples import RangeSamples

PLAIN_SIGMA_M = 0.1
"""Accuracy the radios' maker claims (DW1000 data sheet, 10 cm); for sets that report no sigma."""
_SMALLEST_REPORTED_M = 0.01
LEVELS = (0.68, 0.95)


@dataclass(frozen=True)
class Scored:
    """Held-out ranges under three models: ours, zero bias with reported sigma, fitted Gaussian.

    ``level`` is the smallest highest-density region's mass that holds the measurement.
    """

    samples: RangeSamples
    nll: dict[str, Float[NDArray, "n"]]
    level: dict[str, Float[NDArray, "n"]]


def link_numbers(model: RangeModel, samples: RangeSamples) -> NDArray[np.int64]:
    """The model's law for each row."""
    return np.array([model.link_number(*link) for link in samples.links])[samples.link]


def _gaussian(error_m: NDArray, sigma_m: NDArray) -> tuple[NDArray, NDArray]:
    z = error_m / sigma_m
    return 0.5 * z**2 + np.log(sigma_m) + 0.5 * np.log(2 * np.pi), 2 * ndtr(np.abs(z)) - 1


def _fitted_gaussian(train: RangeSamples, test: RangeSamples) -> tuple[NDArray, NDArray]:
    """Bias and sigma a link; a link without training ranges has those of all."""
    bias, sigma = (
        np.full(len(test.links), train.error_m.mean()),
        np.full(len(test.links), train.error_m.std()),
    )
    for i, link in enumerate(test.links):
        if link in train.links:
            own = train.error_m[train.link == train.links.index(link)]
            if len(own) > 2:
                bias[i], sigma[i] = own.mean(), max(own.std(), _SMALLEST_REPORTED_M)
    return _gaussian(test.error_m - bias[test.link], sigma[test.link])


def score(model: RangeModel, train: RangeSamples, test: RangeSamples) -> Scored:
    """All three on ranges ``test``, fitted to ``train``."""
    numbers = link_numbers(model, test)
    reported = test.reported_sigma_m
    plain = np.full(len(test.link), PLAIN_SIGMA_M)
    if reported is not None:
        plain = np.maximum(reported, _SMALLEST_REPORTED_M)
    ours = (
        -model.log_density(numbers, test.range_m, test.true_range_m),
        model.hdr_level(numbers, test.range_m, test.true_range_m),
    )
    of = {
        "calibrated": ours,
        "plain": _gaussian(test.error_m, plain),
        "constant": _gaussian(test.error_m, np.full(len(test.link), PLAIN_SIGMA_M)),
        "gaussian": _fitted_gaussian(train, test),
    }
    return Scored(test, {k: v[0] for k, v in of.items()}, {k: v[1] for k, v in of.items()})


def join(parts: Sequence[Scored]) -> tuple[dict[str, NDArray], dict[str, NDArray]]:
    """NLL and levels of several held-out parts, all ranges alike."""
    names = parts[0].nll
    return (
        {name: np.concatenate([part.nll[name] for part in parts]) for name in names},
        {name: np.concatenate([part.level[name] for part in parts]) for name in names},
    )


def summary(nll: dict[str, NDArray], level: dict[str, NDArray]) -> dict[str, Any]:
    """Mean NLL [nats] and share of ranges inside the claimed regions."""
    result: dict[str, Any] = {"ranges": len(nll["calibrated"])}
    for name in nll:
        result[name] = {"nll": float(nll[name].mean())}
        result[name] |= {f"coverage_{p * 100:.0f}": float((level[name] <= p).mean()) for p in LEVELS}
    return result
