"""UWB ranges, thinned to a steady rate with outliers voted down inside each window."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import RangeTrack, RobotLog
from mulan.wireless.types import Range

_SIGMA_OF_MEDIAN = 1.2533  # √(π/2): a median of Gaussian samples against their mean


@dataclass(frozen=True)
class RangingConfig:
    """How UWB ranges are thinned."""

    rate_hz: float = 2.0
    """Ranges kept a second, pair and direction."""
    smallest_sigma_m: float = 0.02
    """Floor of a thinned range's standard deviation."""


def _robust_level(time_s: Float[NDArray, "n"], value: Float[NDArray, "n"]) -> float:
    """Value at the mean time: median about a Theil-Sen slope (Sen 1968), so motion is no outlier."""
    i, j = np.triu_indices(len(time_s), 1)
    apart = time_s[j] > time_s[i]
    slope = 0.0
    if len(time_s) >= 4 and apart.any():
        slope = float(np.median((value[j] - value[i])[apart] / (time_s[j] - time_s[i])[apart]))
    return float(np.median(value - slope * (time_s - time_s.mean())))


def _thin(observer: str, track: RangeTrack, config: RangingConfig) -> list[Range]:
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
        InputError: A track is entirely unusable, reports no sigma, or names an unknown peer.
    """
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
            ranges.extend(_thin(robot.name, track, config))
    return ranges
