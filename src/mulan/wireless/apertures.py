"""Synthetic apertures: stretches in which one robot moved its antenna while the other stood still."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.mission.types import OdometryTrack, RobotLog
from mulan.wireless.channel import PacketPairs
from mulan.wireless.link_faults import LinkFault, faults_during


@dataclass(frozen=True)
class ApertureConfig:
    """What counts as an aperture."""

    longest_gap_s: float = 0.5
    """A longer silence between usable packets ends the aperture."""
    longest_duration_s: float = 10.0
    """Longer motions are cut into equal parts, since odometry drifts."""
    smallest_extent_wavelengths: float = 3.0
    """Diagonal of the observer's antenna path, at least."""
    still_tolerance_wavelengths: float = 0.125
    """The peer counts as standing still while its antenna stays this close (RMS) to its mean position."""
    fewest_packets: int = 40
    """Fewer paired packets give no bearing."""


@dataclass(frozen=True)
class Aperture:
    """Round-trip channel along a known antenna path.

    Attributes:
        observer, peer: Robot names.
        time_s, peer_time_s: Packet times on each one's own clock.
        position_odom_m: Observer's antenna in its odometry frame, one row a packet.
        channel: Round-trip channel of every subcarrier.
        wavelength_m: Carrier wavelength.
        reference: Index of the packet at the reference instant (the middle one).
        T_odom_body: Observer's body pose there.
        faults: What was found to be wrong with these packets.
    """

    observer: str
    peer: str
    time_s: Float[NDArray, "n"]
    peer_time_s: Float[NDArray, "n"]
    position_odom_m: Float[NDArray, "n 3"]
    channel: Complex[NDArray, "n s"]
    wavelength_m: float
    reference: int
    T_odom_body: Float[NDArray, "4 4"]
    faults: tuple[LinkFault, ...] = ()


def antenna_path(
    odometry: OdometryTrack, lever_body_m: Float[NDArray, "3"], time_s: Float[NDArray, "n"]
) -> Float[NDArray, "n 3"]:
    """Antenna positions in the odometry frame at given times."""
    T = se3.interpolate(odometry.time_s, odometry.T_odom_body, time_s)
    return T[:, :3, :3] @ lever_body_m + T[:, :3, 3]


def _moving(
    odometry: OdometryTrack, lever_m: Float[NDArray, "3"], time_s: Float[NDArray, "n"], tolerance_m: float
) -> Bool[NDArray, "n"]:
    """Whether the antenna leaves the tolerance within a quarter of a second."""
    return (
        np.linalg.norm(
            antenna_path(odometry, lever_m, time_s + 0.125) - antenna_path(odometry, lever_m, time_s - 0.125),
            axis=1,
        )
        > tolerance_m
    )


def _rms_about_mean(points: Float[NDArray, "n 3"]) -> float:
    return float(np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean()))


def find_apertures(
    pairs: PacketPairs, observer: RobotLog, peer: RobotLog, config: ApertureConfig
) -> list[Aperture]:
    """The apertures of one observer towards one peer, each according to its own odometry.

    Args:
        pairs: Packets with ``pairs.observer`` the robot asked about (see ``PacketPairs.swapped``).
        observer: Log of the robot that moved.
        peer: Log of the one that stood still.
        config: Thresholds.
    """
    tolerance_m = config.still_tolerance_wavelengths * pairs.wavelength_m
    inside = (pairs.time_s >= observer.odometry.time_s[0]) & (pairs.time_s <= observer.odometry.time_s[-1])
    active = np.flatnonzero(
        inside
        & _moving(observer.odometry, observer.wifi_antenna_body_m, pairs.time_s, tolerance_m)
        & ~_moving(peer.odometry, peer.wifi_antenna_body_m, pairs.peer_time_s, tolerance_m)
    )
    found: list[Aperture] = []
    if len(active) == 0:
        return found
    bursts = np.split(active, np.flatnonzero(np.diff(pairs.time_s[active]) > config.longest_gap_s) + 1)
    for burst in bursts:
        duration = pairs.time_s[burst[-1]] - pairs.time_s[burst[0]]
        for index in np.array_split(burst, max(1, int(np.ceil(duration / config.longest_duration_s)))):
            if len(index) < config.fewest_packets:
                continue
            time_s, peer_time_s = pairs.time_s[index], pairs.peer_time_s[index]
            path = antenna_path(observer.odometry, observer.wifi_antenna_body_m, time_s)
            peer_path = antenna_path(peer.odometry, peer.wifi_antenna_body_m, peer_time_s)
            extent_m = float(np.linalg.norm(np.ptp(path, axis=0)))
            if extent_m < config.smallest_extent_wavelengths * pairs.wavelength_m:
                continue
            if _rms_about_mean(peer_path) > tolerance_m:
                continue
            reference = len(index) // 2
            T = se3.interpolate(
                observer.odometry.time_s, observer.odometry.T_odom_body, time_s[reference, None]
            )[0]
            found.append(
                Aperture(
                    pairs.observer,
                    pairs.peer,
                    time_s,
                    peer_time_s,
                    path,
                    pairs.channel[index],
                    pairs.wavelength_m,
                    reference,
                    T,
                    faults_during(pairs.faults, time_s),
                )
            )
    return found
