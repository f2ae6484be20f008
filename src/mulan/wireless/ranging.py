"""UWB ranges, thinned to a steady rate with outliers voted down inside each window."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import RangeTrack, RobotLog
from mulan.wireless.range_model import RangeModel, load_range_model
from mulan.wireless.types import Range

_SIGMA_OF_MEDIAN = 1.2533  # √(π/2): a median of Gaussian samples against their mean


@dataclass(frozen=True)
class RangingConfig:
    """How UWB ranges are thinned."""

    rate_hz: float = 2.0
    """Ranges kept a second, pair and direction."""
    smallest_sigma_m: float = 0.02
    """Floor of a thinned range's standard deviation."""
    calibration: Path | None = None
    """Error laws fitted to recordings with truth (a saved RangeModel); none trusts what the radio reports."""
    reject_above: float = 0.5
    """With a calibration: a range whose outlier probability beside its window exceeds this is left out."""
    share_error: bool = True
    """With a calibration: ranges that share one lasting error get, together, the weight of one."""


def _robust_level(time_s: Float[NDArray, "n"], value: Float[NDArray, "n"]) -> float:
    """Value at the mean time: median about a Theil-Sen slope (Sen 1968), so motion is no outlier."""
    i, j = np.triu_indices(len(time_s), 1)
    apart = time_s[j] > time_s[i]
    slope = 0.0
    if len(time_s) >= 4 and apart.any():
        slope = float(np.median((value[j] - value[i])[apart] / (time_s[j] - time_s[i])[apart]))
    return float(np.median(value - slope * (time_s - time_s.mean())))


def _calibrated(
    observer: str,
    peer: str,
    time_s: Float[NDArray, "n"],
    range_m: Float[NDArray, "n"],
    model: RangeModel,
    config: RangingConfig,
) -> Range | None:
    """One window freed of bias and outliers; None if nothing in it is to be believed."""
    law = model.law(observer, peer)
    distance = model.distance_m(law, range_m)
    level = _robust_level(time_s, distance)
    drift = distance - level
    if len(time_s) >= 4:
        drift = distance - np.array([_robust_level(time_s - t + time_s.mean(), distance) for t in time_s])
    sigma = law.sigma_m / np.sqrt(len(time_s))
    late = model.outlier_probability(law, range_m, distance - drift, sigma)
    good = late <= config.reject_above
    if not good.any():
        return None
    independent = float(good.sum())
    if config.share_error and model.correlation_s > 0:
        independent = min(independent, 1 / (config.rate_hz * model.correlation_s))
    sigma = max(law.sigma_m / np.sqrt(independent), config.smallest_sigma_m)
    at_s, level = float(time_s[good].mean()), _robust_level(time_s[good], distance[good])
    return Range(observer, peer, at_s, level, sigma, law.outlier_mass, model.correlation_s)


def _thin(
    observer: str, track: RangeTrack, config: RangingConfig, model: RangeModel | None = None
) -> list[Range]:
    source = f"/{observer}/range/{track.peer}"
    usable = np.isfinite(track.range_m) & (track.range_m > 0) & np.isfinite(track.time_s)
    if len(usable) and not usable.any():
        raise InputError(source, "range", "no value is finite and positive", "check the UWB driver")
    if not (track.sigma_m[usable] > 0).all():
        raise InputError(
            source, "sigma", "is not positive", "report the radio's standard deviation in metres"
        )
    time_s, range_m, sigma_m = track.time_s[usable], track.range_m[usable], track.sigma_m[usable]
    window = np.floor(time_s * config.rate_hz).astype(int)
    thinned = []
    for index in np.split(np.arange(len(window)), np.flatnonzero(np.diff(window)) + 1) if len(window) else []:
        count = len(index)
        if model is not None:
            kept = _calibrated(observer, track.peer, time_s[index], range_m[index], model, config)
            thinned.extend([kept] if kept else [])
            continue
        reduction = _SIGMA_OF_MEDIAN / np.sqrt(count) if count >= 3 else 1.0
        sigma = float(np.median(sigma_m[index])) * reduction
        if count >= 3:
            at_s, level_m = float(time_s[index].mean()), _robust_level(time_s[index], range_m[index])
        else:
            at_s, level_m = float(time_s[index[-1]]), float(range_m[index[-1]])
        thinned.append(Range(observer, track.peer, at_s, level_m, max(sigma, config.smallest_sigma_m)))
    return thinned


def thin_ranges(robots: Sequence[RobotLog], config: RangingConfig) -> list[Range]:
    """Ranges of all pairs, in both directions, each window of one over the rate voted into one value.

    Raises:
        InputError: A track is entirely unusable, reports no sigma, or names an unknown peer; or the
            calibration cannot be read.
    """
    model = None if config.calibration is None else load_range_model(config.calibration)
    names = {robot.name for robot in robots}
    ranges: list[Range] = []
    for robot in robots:
        for peer, track in robot.ranges.items():
            if peer not in names:
                raise InputError(
                    f"/{robot.name}/range/{peer}",
                    "peer",
                    "is no robot of this mission",
                    "fix the topic mapping",
                )
            ranges.extend(_thin(robot.name, track, config, model))
    return ranges
