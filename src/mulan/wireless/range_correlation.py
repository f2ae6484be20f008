"""How long a UWB link's error lasts: multipath changes with metres moved, not with the radio's rate."""

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

_NEGLIGIBLE = 0.05
_CLIP = 4.0
_LONGEST_GAP = 20


def correlation_time_s(
    link: Int[NDArray, "n"], time_s: Float[NDArray, "n"], error_m: Float[NDArray, "n"]
) -> tuple[float, Float[NDArray, "n"]]:
    """Seconds for which one independent measurement of a link stands, and each row's share of one.

    The integrated autocorrelation of the errors about each link's median, clipped so that outliers do not
    hide it, summed up to the first negligible lag (Sokal 1997). Recordings are told apart by gaps of more
    than 20 steps. The time is zero where neighbours are independent.
    """
    weight = np.ones(len(error_m))
    series: list[tuple[NDArray, NDArray]] = []
    steps = []
    for number in np.unique(link):
        rows = np.flatnonzero(link == number)
        rows = rows[np.argsort(time_s[rows], kind="stable")]
        z = error_m[rows] - np.median(error_m[rows])
        z = np.clip(z / (1.4826 * np.median(np.abs(z)) + 1e-3), -_CLIP, _CLIP)
        step = np.diff(time_s[rows])
        usual = float(np.median(step[step > 0])) if (step > 0).any() else 0.0
        cuts = np.flatnonzero(step > _LONGEST_GAP * usual) + 1
        parts = [part for part in np.split(np.arange(len(rows)), cuts) if len(part) > 1]
        series.extend((rows[part], z[part]) for part in parts)
        steps.append(usual)
    if not series:
        return 0.0, weight
    step_s = float(np.median(steps))
    longest = max(len(z) for _, z in series)
    power = sum(float(z @ z) for _, z in series) / sum(len(z) for _, z in series)
    inflation = 1.0
    for lag in range(1, longest // 2):
        pairs = [(float(z[:-lag] @ z[lag:]), len(z) - lag) for _, z in series if len(z) > lag]
        rho = sum(p for p, _ in pairs) / (sum(c for _, c in pairs) * power) if power > 0 else 0.0
        if rho < _NEGLIGIBLE:
            break
        inflation += 2 * rho
    if inflation <= 1.1:
        return 0.0, weight
    for rows, _ in series:
        weight[rows] = max(1 / inflation, 1 / len(rows))
    return inflation * step_s, weight
