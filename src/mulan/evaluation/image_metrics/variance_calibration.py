"""Whether the variance a field renders tells where, and by how much, its colours are wrong."""

import math

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.radiance.engine import Rendering
from mulan.reconstruction.captured_image import CapturedImage

STEPS = 20
TWO_SIDED_95 = 1.959964
"""Standard deviations that hold 95 % of a normal distribution."""


class VarianceJudge:
    """Ranking (AUSE) and coverage of the rendered variance, on the object where it was cut out.

    A white background is easy and would flatter both.
    """

    def __call__(self, rendering: Rendering, image: CapturedImage) -> dict[str, float | None]:
        """``ause`` (0 = ranks like the error itself), ``coverage_95`` (0.95 = honest); None if empty."""
        error = rendering.colour.numpy() - image.colour_fraction.reshape(-1, 3)
        variance = rendering.variance.numpy().astype(float)
        seen = object_pixels(image)
        if not seen.any():
            return {"ause": None, "coverage_95": None}
        return {
            "ause": ause((error[seen].astype(float) ** 2).mean(-1), variance[seen]),
            "coverage_95": coverage(error[seen], variance[seen]),
        }


def object_pixels(image: CapturedImage) -> Bool[NDArray, "r"]:
    """Pixels the object covers at least half of; all of a photograph that has its own background."""
    if image.alpha is None:
        return np.ones(image.colour.shape[0] * image.colour.shape[1], dtype=bool)
    return image.alpha.reshape(-1) >= 128


def ause(squared_error: Float[NDArray, "n"], variance: Float[NDArray, "n"]) -> float:
    """Area under the sparsification error (Ilg et al. 2018).

    RMS error of what is left as the most uncertain pixels are taken away, above what taking away the worst
    would leave, as a share of the RMS error of all.
    """
    whole = math.sqrt(float(squared_error.mean()))
    if whole == 0:
        return 0.0
    by_variance = _rms_left(squared_error[np.argsort(variance, kind="stable")])
    by_error = _rms_left(np.sort(squared_error))
    return float((by_variance - by_error).mean()) / whole


def _rms_left(squared_error: Float[NDArray, "n"]) -> Float[NDArray, "steps"]:
    """RMS of the first 100 %, 95 %, … 5 %."""
    n = len(squared_error)
    left = np.maximum(np.ceil(n * (1 - np.arange(STEPS) / STEPS)).astype(int), 1)
    return np.sqrt(np.cumsum(squared_error)[left - 1] / left)


def coverage(error: Float[NDArray, "n 3"], variance: Float[NDArray, "n"]) -> float:
    """Share of colour channels within the 95 % interval the variance gives."""
    return float((np.abs(error) <= TWO_SIDED_95 * np.sqrt(variance)[:, None]).mean())
