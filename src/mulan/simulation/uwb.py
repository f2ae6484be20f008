"""UWB ranges: Gaussian noise, a constant bias a pair, and late non-line-of-sight outliers."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.mission.types import RangeTrack
from mulan.simulation.radio import AntennaPath


@dataclass(frozen=True)
class UwbConfig:
    """The ranging radio."""

    sigma_m: float = 0.05
    """Noise of one range (one sigma), also what the radio reports as its sigma."""
    bias_m: float = 0.0
    """Mean bias over pairs of robots."""
    bias_sigma_m: float = 0.02
    """Spread of the bias from pair to pair; constant within a mission."""
    outlier_rate: float = 0.0
    """Fraction of ranges that took a detour."""
    outlier_mean_m: float = 1.0
    """Mean length of that detour (exponential)."""
    rate_hz: float = 5.0
    """Ranges a second, pair and direction."""


def simulate_ranges(
    names: tuple[str, str],
    antennas: tuple[AntennaPath, AntennaPath],
    end_s: float,
    config: UwbConfig,
    rng: np.random.Generator,
) -> tuple[RangeTrack, RangeTrack]:
    """Ranges of one pair of robots from time zero to the end, each robot initiating in turn.

    Args:
        names: The two robots.
        antennas: Where their UWB antennas truly are.
        end_s: End of the mission.
        config: The radio.
        rng: Source of all randomness.

    Returns:
        What the first robot recorded of the second, and the second (half a period later) of the first.
    """
    bias_m = config.bias_m + config.bias_sigma_m * rng.normal()
    period_s = 1.0 / config.rate_hz

    def track(peer: str, time_s: Float[NDArray, "n"]) -> RangeTrack:
        distance_m = np.linalg.norm(antennas[0](time_s) - antennas[1](time_s), axis=1)
        late = rng.random(len(time_s)) < config.outlier_rate
        detour_m = np.where(late, rng.exponential(config.outlier_mean_m, len(time_s)), 0.0)
        range_m = distance_m + bias_m + detour_m + config.sigma_m * rng.normal(size=len(time_s))
        return RangeTrack(peer, time_s, np.maximum(range_m, 0.0), np.full(len(time_s), config.sigma_m))

    return (
        track(names[1], np.arange(0.0, end_s, period_s)),
        track(names[0], np.arange(period_s / 2, end_s, period_s)),
    )
