"""Antennas of a receiver that deliver nothing: zero, not finite, constant, or far weaker than another."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from jaxtyping import Complex
from numpy.typing import NDArray

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
        below_strongest_db: How much weaker it is than the strongest good antenna; infinite without any power.
    """

    antenna: int
    kind: FaultKind
    below_strongest_db: float


def antenna_faults(track: CsiTrack) -> tuple[AntennaFault, ...]:
    """Antennas of a track that no estimator may use."""
    finite = np.asarray(np.isfinite(track.channel).all(2))
    power = np.median((np.abs(np.where(finite[..., None], track.channel, 0)) ** 2).mean(2), 0)
    kinds = [_kind(track.channel[finite[:, k], k], len(finite)) for k in range(len(power))]
    strongest = max((p for p, kind in zip(power, kinds, strict=True) if kind is None), default=power.max())
    faults = []
    for antenna, kind in enumerate(kinds):
        below_db = float(10 * np.log10(strongest / power[antenna])) if power[antenna] > 0 else float("inf")
        if kind is None and below_db > _WEAK_DB:
            kind = FaultKind.WEAK
        if kind is not None:
            faults.append(AntennaFault(antenna, kind, below_db))
    return tuple(faults)


def _kind(seen: Complex[NDArray, "n s"], packets: int) -> FaultKind | None:
    """What is wrong with one antenna by itself; ``seen`` are its finite packets."""
    if 2 * len(seen) < packets:
        return FaultKind.NOT_FINITE
    if 2 * np.count_nonzero(seen.any(1)) < len(seen):
        return FaultKind.ZERO
    if len(seen) >= _FEWEST_TO_JUDGE and (seen == seen[0]).all():
        return FaultKind.CONSTANT
    return None
