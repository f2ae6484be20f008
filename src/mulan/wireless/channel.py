"""From raw CSI of both directions to a round-trip channel per packet pair, free of clock offsets."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import CsiTrack, RobotLog
from mulan.wireless.link_faults import LinkFault, jump_faults, track_faults
from mulan.wireless.packet_delay import band_centre_hz, channel_at_centre, freed_of_delay
from mulan.wireless.pairing import pair_indices
from mulan.wireless.phase_jumps import round_trip_jumps

__all__ = ["PacketPairs", "channel_at_centre", "freed_of_delay", "pair_packets", "usable_packets"]

SPEED_OF_LIGHT_M_S = 299_792_458.0
_FEWEST_TO_JUDGE = 10


@dataclass(frozen=True)
class PacketPairs:
    """Packets and their replies between two robots.

    Attributes:
        observer, peer: Robot names.
        time_s, peer_time_s: Reception times on each one's own clock; ``time_s`` increases.
        channel: Forward x reverse channel of every subcarrier, each direction freed of its own delay, so that
            all refer to the band centre; carrier offset and timing cancelled.
        wavelength_m: At the band centre.
        faults: What was found to be wrong and forbids no bearing.
    """

    observer: str
    peer: str
    time_s: Float[NDArray, "n"]
    peer_time_s: Float[NDArray, "n"]
    channel: Complex[NDArray, "n s"]
    wavelength_m: float
    faults: tuple[LinkFault, ...] = ()

    def swapped(self) -> "PacketPairs":
        """The same packets seen from the peer."""
        order = np.argsort(self.peer_time_s, kind="stable")
        faults = tuple(
            fault
            if fault.time_s is None
            else replace(fault, time_s=float(np.interp(fault.time_s, self.time_s, self.peer_time_s)))
            for fault in self.faults
        )
        return PacketPairs(
            self.peer,
            self.observer,
            self.peer_time_s[order],
            self.time_s[order],
            self.channel[order],
            self.wavelength_m,
            faults,
        )


def usable_packets(track: CsiTrack, receiver: str) -> Bool[NDArray, "n"]:
    """Which packets carry a channel on the first antenna (the one whose lever arm is known).

    Raises:
        InputError: Most packets are zero or not finite, or all are the same: the receiver was dead.
    """
    first = track.channel[:, 0, :]
    finite = np.isfinite(first).all(1)
    good = finite & (np.abs(np.where(np.isfinite(first), first, 0)).max(1) > 0)
    source, remedy = (
        f"/{receiver}/csi/{track.peer}",
        "check the antenna cable and the CSI driver, or leave this pair out",
    )
    if 2 * good.sum() < len(good):
        kind = "zero" if finite.all() else "not finite (NaN)"
        raise InputError(
            source, "channel", f"{len(good) - good.sum()} of {len(good)} packets are {kind}", remedy
        )
    if good.sum() >= _FEWEST_TO_JUDGE and (first[good] == first[good][0]).all():
        raise InputError(source, "channel", "every packet carries the same constant values", remedy)
    return good


def _rows(track: CsiTrack, rows: Int[NDArray, "k"]) -> CsiTrack:
    return replace(
        track,
        time_s=track.time_s[rows],
        frame_counter=track.frame_counter[rows],
        channel=track.channel[rows],
    )


def pair_packets(observer: RobotLog, peer: RobotLog, undo_phase_jumps: bool = False) -> PacketPairs:
    """Pair packets and multiply both directions, which cancels the CFO (readings.md, row 5).

    Packets pair by frame counter, by time where no counter matches.

    Args:
        observer: Whose clock counts.
        peer: The other robot.
        undo_phase_jumps: Turn back the quarter and half turns that are found, instead of only telling.

    Raises:
        InputError: A direction is missing or dead, the bands differ, no counter occurs on both
            sides and the times do not tell which packets belong together, or the phase keeps jumping.
    """
    for receiver, sender in ((observer, peer), (peer, observer)):
        if sender.name not in receiver.csi:
            raise InputError(
                f"/{receiver.name}/csi/{sender.name}",
                "csi",
                "is missing although the other direction was recorded",
                "record CSI on both robots",
            )
    forward, reverse = observer.csi[peer.name], peer.csi[observer.name]
    if not np.array_equal(forward.subcarrier_hz, reverse.subcarrier_hz):
        raise InputError(
            f"/{observer.name}/csi/{peer.name}",
            "subcarrier_hz",
            "differs between the two directions",
            "record both on one channel with the same subcarrier grouping",
        )
    keep_forward = np.flatnonzero(usable_packets(forward, observer.name))
    keep_reverse = np.flatnonzero(usable_packets(reverse, peer.name))
    faults = track_faults(forward, observer.name) + track_faults(reverse, peer.name)
    i, j = pair_indices(_rows(forward, keep_forward), _rows(reverse, keep_reverse))
    i, j = keep_forward[i], keep_reverse[j]
    sides = forward.channel[i, 0], reverse.channel[j, 0]
    hz = forward.subcarrier_hz
    product = freed_of_delay(sides[0], hz) * freed_of_delay(sides[1], hz)
    jumps = round_trip_jumps(*sides, hz)
    source = f"/{observer.name}/csi/{peer.name} with its replies"
    faults += jump_faults(jumps, source, forward.time_s[i], undo_phase_jumps)
    if undo_phase_jumps:
        product = jumps.undone(product)
    return PacketPairs(
        observer.name,
        peer.name,
        forward.time_s[i],
        reverse.time_s[j],
        product,
        SPEED_OF_LIGHT_M_S / band_centre_hz(hz),
        faults,
    )
