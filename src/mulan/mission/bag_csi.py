"""Channel state messages as one track a peer, checked."""

from typing import Any

import numpy as np
from jaxtyping import Complex
from numpy.typing import NDArray

from mulan.mission import messages
from mulan.mission.bag_topics import BagTopics
from mulan.mission.bag_tracks import by_peer
from mulan.mission.ros_stamps import stamp_s
from mulan.mission.types import CsiTrack

_REMEDY = "check the CSI logger, or leave the topic out"


def csi(bag: BagTopics, robot: str) -> dict[str, CsiTrack]:
    """Channel state by peer; no entry where the robot has no ``csi`` topic.

    Raises:
        InputError: The topic is there but empty, arrays disagree in length, are empty or not finite, change
            shape or frequencies between packets, or a peer's channel is zero throughout.
    """
    topic = messages.CSI.of(robot)
    found = bag.of(topic)
    if bag.has(topic) and not found:
        raise bag.error(topic, "is a zero-length CSI log (no messages)", _REMEDY)
    return {peer: _track(bag, topic, peer, packets) for peer, packets in by_peer(found).items()}


def _track(bag: BagTopics, topic: str, peer: str, packets: list[Any]) -> CsiTrack:
    first = packets[0]
    subcarrier_hz = np.array(first.subcarrier_hz, dtype=float)
    if not np.isfinite(subcarrier_hz).all() or (subcarrier_hz <= 0).any():
        raise bag.error(topic, f"subcarrier_hz from '{peer}' is not a positive frequency", _REMEDY)
    for packet in packets:
        subcarriers = len(packet.subcarrier_hz)
        length = packet.antennas * subcarriers
        if len(packet.real) != length or len(packet.imag) != length:
            raise bag.error(
                topic,
                f"packet {packet.frame_counter} from '{peer}' has {len(packet.real)} real and"
                f" {len(packet.imag)} imaginary numbers for {packet.antennas} antennas x"
                f" {subcarriers} subcarriers",
                _REMEDY,
            )
        if length == 0:
            raise bag.error(
                topic, f"packet {packet.frame_counter} from '{peer}' has a zero-length channel", _REMEDY
            )
        if packet.antennas != first.antennas or not np.array_equal(packet.subcarrier_hz, subcarrier_hz):
            raise bag.error(
                topic,
                f"antennas or subcarriers change at packet {packet.frame_counter} from '{peer}'",
                _REMEDY,
            )
    shape = (len(packets), first.antennas, len(subcarrier_hz))
    channel = _complex(packets).reshape(shape)
    if not np.isfinite(channel).all():
        raise bag.error(topic, f"the channel from '{peer}' holds NaN or infinity", _REMEDY)
    if not channel.any():
        raise bag.error(topic, f"the channel from '{peer}' is zero throughout", _REMEDY)
    return CsiTrack(
        peer=peer,
        time_s=np.array([stamp_s(packet) for packet in packets], dtype=float),
        frame_counter=np.array([packet.frame_counter for packet in packets], dtype=np.uint32),
        channel=channel,
        subcarrier_hz=subcarrier_hz,
    )


def _complex(packets: list[Any]) -> Complex[NDArray, "n numbers"]:
    real = np.array([packet.real for packet in packets], dtype=float)
    return real + 1j * np.array([packet.imag for packet in packets], dtype=float)
