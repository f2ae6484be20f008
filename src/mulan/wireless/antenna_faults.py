"""Antennas of a receiver that deliver nothing: zero, not finite, constant, or far weaker than another."""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from mulan.mission.types import CsiTrack

_WEAK_DB = 15.0  # unconnected chains of the WSR cards are 19 to 31 dB below the connected one
_FEWEST_TO_JUDGE = 10


class FaultKind(Enum):
    """What is wrong; the value completes the sentence "antenna 2 is ..."."""

    ZERO = "zero in most packets"
    NOT_FINITE = "not finite in most packets"
    CONSTANT = "the same in every packet"
    WEAK = "so weak that no antenna can be connected"


@dataclass(frozen=True)
class AntennaFault:
    """One antenna without a channel.

    Attributes:
        antenna: Its index in ``CsiTrack.channel``.
        kind: What is wrong.
        below_strongest_db: How much weaker it is than the strongest antenna; infinite without any power.
    """

    antenna: int
    kind: FaultKind
    below_strongest_db: float


def antenna_faults(track: CsiTrack) -> tuple[AntennaFault, ...]:
    """Antennas of a track that no estimator may use."""
    finite = np.asarray(np.isfinite(track.channel).all(2))
    power = (np.abs(np.where(finite[..., None], track.channel, 0)) ** 2).mean(2)
    median = np.median(power, 0)
    faults = []
    for antenna in range(track.channel.shape[1]):
        seen = track.channel[finite[:, antenna], antenna]
        below_db = 10 * np.log10(median.max() / median[antenna]) if median[antenna] > 0 else np.inf
        if 2 * len(seen) < len(track.time_s):
            kind = FaultKind.NOT_FINITE
        elif median[antenna] == 0:
            kind = FaultKind.ZERO
        elif len(seen) >= _FEWEST_TO_JUDGE and (seen == seen[0]).all():
            kind = FaultKind.CONSTANT
        elif below_db > _WEAK_DB:
            kind = FaultKind.WEAK
        else:
            continue
        faults.append(AntennaFault(antenna, kind, float(below_db)))
    return tuple(faults)
