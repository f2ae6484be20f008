"""From raw CSI of both directions to a round-trip channel per packet pair, free of clock offsets."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.types import CsiTrack, RobotLog
from mulan.wireless.pairing import pair_indices

SPEED_OF_LIGHT_M_S = 299_792_458.0
_MAX_DELAY_S = 400e-9  # packet detection jitter is a few 50 ns samples
_DELAY_STEP_S = 10e-9  # a sixth of a 20 MHz band's resolution, so Newton starts on the main lobe
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
    """

    observer: str
    peer: str
    time_s: Float[NDArray, "n"]
    peer_time_s: Float[NDArray, "n"]
    channel: Complex[NDArray, "n s"]
    wavelength_m: float

    def swapped(self) -> "PacketPairs":
        """The same packets seen from the peer."""
        order = np.argsort(self.peer_time_s, kind="stable")
        return PacketPairs(
            self.peer,
            self.observer,
            self.peer_time_s[order],
            self.time_s[order],
            self.channel[order],
            self.wavelength_m,
        )


def band_centre_hz(subcarrier_hz: Float[NDArray, "s"]) -> float:
    """Middle of the band (the carrier, for a symmetric grouping)."""
    return float(subcarrier_hz.min() + subcarrier_hz.max()) / 2


def freed_of_delay(
    channel: Complex[NDArray, "n s"], subcarrier_hz: Float[NDArray, "s"]
) -> Complex[NDArray, "n s"]:
    """Each packet's channel with its linear phase over the subcarriers removed about the band centre.

    The delay is the one with the strongest coherent sum (a search and two Newton steps), so no phase is ever
    unwrapped. What differs between subcarriers afterwards is multipath and noise.
    """
    offset = 2 * np.pi * (subcarrier_hz - band_centre_hz(subcarrier_hz))
    delays = np.arange(-_MAX_DELAY_S, _MAX_DELAY_S + _DELAY_STEP_S / 2, _DELAY_STEP_S)
    spectrum = np.abs(channel @ np.exp(1j * np.outer(offset, delays)))
    delay = delays[spectrum.argmax(1)]
    for _ in range(2):
        turned = channel * np.exp(1j * np.outer(delay, offset))
        total, first, second = turned.sum(1), turned @ (1j * offset), turned @ (-(offset**2))
        slope = 2 * (first * total.conj()).real
        curvature = 2 * ((second * total.conj()).real + np.abs(first) ** 2)
        step = np.where(curvature < 0, -slope / np.where(curvature < 0, curvature, -1.0), 0.0)
        delay = delay + np.clip(step, -_DELAY_STEP_S, _DELAY_STEP_S)
    return channel * np.exp(1j * np.outer(delay, offset))


def channel_at_centre(
    channel: Complex[NDArray, "n s"], subcarrier_hz: Float[NDArray, "s"]
) -> Complex[NDArray, "n"]:
    """Each packet's channel at the band centre: the average over subcarriers freed of the delay."""
    return freed_of_delay(channel, subcarrier_hz).mean(1)


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


def pair_packets(observer: RobotLog, peer: RobotLog) -> PacketPairs:
    """Pair packets and multiply both directions, which cancels the CFO (readings.md, row 5).

    Packets pair by frame counter, by time where no counter matches.

    Raises:
        InputError: A direction is missing or dead, the bands differ, or no counter occurs on both
            sides and the times do not tell which packets belong together.
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
    i, j = pair_indices(_rows(forward, keep_forward), _rows(reverse, keep_reverse))
    i, j = keep_forward[i], keep_reverse[j]
    product = freed_of_delay(forward.channel[i, 0], forward.subcarrier_hz) * freed_of_delay(
        reverse.channel[j, 0], reverse.subcarrier_hz
    )
    wavelength_m = SPEED_OF_LIGHT_M_S / band_centre_hz(forward.subcarrier_hz)
    return PacketPairs(observer.name, peer.name, forward.time_s[i], reverse.time_s[j], product, wavelength_m)
