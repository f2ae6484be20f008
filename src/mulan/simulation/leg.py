"""What robots record while they move a little, continued where they stopped recording before."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.mission.types import CsiTrack, OdometryTrack, Photo, PoseTrack, RangeTrack, RobotLog
from mulan.simulation.odometry import simulate_odometry, start_frame
from mulan.simulation.propagation import Propagation
from mulan.simulation.radio import simulate_csi
from mulan.simulation.recording import SensorConfig
from mulan.simulation.timeline import RobotMotion
from mulan.simulation.uwb import simulate_ranges


@dataclass(frozen=True)
class Leg:
    """One stretch of a mission.

    Attributes:
        number: How many came before; every leg draws from streams of its own.
        start_s: Mission time at which it begins.
        motions: Of the robots that take part, each on a clock that is zero at the start of the leg.
        photos: What each photographs on the way, stamped with mission time.
    """

    number: int
    start_s: float
    motions: Mapping[str, RobotMotion]
    photos: Mapping[str, tuple[Photo, ...]]

    @property
    def end_s(self) -> float:
        """Mission time at which it ends."""
        return self.start_s + max(motion.end_s for motion in self.motions.values())


def record_leg(
    leg: Leg, logs: Mapping[str, RobotLog], propagation: Propagation, sensors: SensorConfig, seed: int
) -> tuple[RobotLog, ...]:
    """The logs of one leg alone: odometry goes on from where it was, packet counters and clocks too.

    Args:
        leg: Who moves how.
        logs: What every robot recorded so far; their mounts and lenses are kept.
        propagation: What carries the radio.
        sensors: Noise of all sensors.
        seed: Source of all randomness; a pair's constant range bias depends on it alone.
    """
    names, number = list(logs), leg.number
    taking_part = [name for name in names if name in leg.motions]
    csi: dict[str, dict[str, CsiTrack]] = {name: {} for name in taking_part}
    ranges: dict[str, dict[str, RangeTrack]] = {name: {} for name in taking_part}
    for a, b in combinations(taking_part, 2):
        key = names.index(a), names.index(b)
        first, second = leg.motions[a], leg.motions[b]
        rng = np.random.default_rng([seed, 11, number, *key])
        intervals_s = np.concatenate([first.aperture_s, second.aperture_s])
        intervals_s = intervals_s[np.argsort(intervals_s[:, 0])]
        wifi = tuple(_antenna(leg, name, logs[name].wifi_antenna_body_m) for name in (a, b))
        at_a, at_b = simulate_csi((a, b), (wifi[0], wifi[1]), intervals_s, propagation, sensors.radio, rng)
        packets = max(_last_counter(logs[a], b), _last_counter(logs[b], a))
        csi[a][b], csi[b][a] = (_later_packets(track, leg.start_s, packets) for track in (at_a, at_b))
        bias = np.random.default_rng([seed, 12, *key]).normal()
        uwb = replace(
            sensors.uwb, bias_m=sensors.uwb.bias_m + sensors.uwb.bias_sigma_m * bias, bias_sigma_m=0.0
        )
        antennas = tuple(_antenna(leg, name, logs[name].uwb_antenna_body_m) for name in (a, b))
        rng = np.random.default_rng([seed, 13, number, *key])
        to_b, to_a = simulate_ranges((a, b), (antennas[0], antennas[1]), first.end_s, uwb, rng)
        ranges[a][b], ranges[b][a] = (
            replace(track, time_s=track.time_s + leg.start_s) for track in (to_b, to_a)
        )
    recorded = []
    for name in taking_part:
        motion, log = leg.motions[name], logs[name]
        time_s = motion.sample_times()
        T_world_body = motion.pose(time_s)
        rng = np.random.default_rng([seed, 10, number, names.index(name)])
        odometry = simulate_odometry(time_s, T_world_body, sensors.odometry, rng)
        odometry = replace(odometry, time_s=time_s + leg.start_s)
        recorded.append(
            replace(
                log,
                photos=leg.photos.get(name, ()),
                odometry=continued(log.odometry, odometry),
                csi=csi[name],
                ranges=ranges[name],
                ground_truth=PoseTrack(time_s + leg.start_s, T_world_body),
            )
        )
    return tuple(recorded)


def continued(before: OdometryTrack, leg: OdometryTrack) -> OdometryTrack:
    """A leg's dead reckoning in the frame, and with the uncertainty, of what was recorded before it.

    Where the leg begins, roll and pitch are read from gravity anew; only the error of yaw and position is
    carried on.
    """
    if not len(before.time_s):
        return leg
    T_odom_body = start_frame(before.T_odom_body[-1]) @ leg.T_odom_body
    if before.covariance is None or leg.covariance is None:
        return replace(leg, T_odom_body=T_odom_body)
    up = before.T_odom_body[-1, 2, :3]
    keep = np.zeros((6, 6))
    keep[:3, :3], keep[3:, 3:] = np.outer(up, up), np.eye(3)
    carried = keep @ before.covariance[-1] @ keep
    step = se3.inverse(before.T_odom_body[-1]) @ T_odom_body
    covariance = leg.covariance + se3.covariance_of_composition(
        step, np.broadcast_to(carried, leg.covariance.shape)
    )
    return OdometryTrack(leg.time_s, T_odom_body, covariance)


def joined(before: RobotLog, leg: RobotLog) -> RobotLog:
    """One log of what was recorded before and on a leg."""
    odometry, more = before.odometry, leg.odometry
    assert odometry.covariance is not None
    assert more.covariance is not None
    assert before.ground_truth is not None
    assert leg.ground_truth is not None
    return replace(
        before,
        photos=before.photos + leg.photos,
        odometry=OdometryTrack(
            np.concatenate([odometry.time_s, more.time_s]),
            np.concatenate([odometry.T_odom_body, more.T_odom_body]),
            np.concatenate([odometry.covariance, more.covariance]),
        ),
        csi={**before.csi, **{peer: _joined_csi(before.csi.get(peer), t) for peer, t in leg.csi.items()}},
        ranges={
            **before.ranges,
            **{peer: _joined_ranges(before.ranges.get(peer), t) for peer, t in leg.ranges.items()},
        },
        ground_truth=PoseTrack(
            np.concatenate([before.ground_truth.time_s, leg.ground_truth.time_s]),
            np.concatenate([before.ground_truth.T_world_body, leg.ground_truth.T_world_body]),
        ),
    )


def _joined_csi(before: CsiTrack | None, leg: CsiTrack) -> CsiTrack:
    if before is None:
        return leg
    return replace(
        leg,
        time_s=np.concatenate([before.time_s, leg.time_s]),
        frame_counter=np.concatenate([before.frame_counter, leg.frame_counter]),
        channel=np.concatenate([before.channel, leg.channel]),
    )


def _joined_ranges(before: RangeTrack | None, leg: RangeTrack) -> RangeTrack:
    if before is None:
        return leg
    return RangeTrack(
        leg.peer,
        np.concatenate([before.time_s, leg.time_s]),
        np.concatenate([before.range_m, leg.range_m]),
        np.concatenate([before.sigma_m, leg.sigma_m]),
    )


def _later_packets(track: CsiTrack, start_s: float, packets: int) -> CsiTrack:
    counter = (track.frame_counter + np.uint32(packets)).astype(np.uint32)
    return replace(track, time_s=track.time_s + start_s, frame_counter=counter)


def _last_counter(log: RobotLog, peer: str) -> int:
    track = log.csi.get(peer)
    return int(track.frame_counter[-1]) if track is not None and len(track.frame_counter) else 0


def _antenna(
    leg: Leg, name: str, lever_body_m: Float[NDArray, "3"]
) -> Callable[[Float[NDArray, "n"]], Float[NDArray, "n 3"]]:
    return partial(leg.motions[name].point, lever_body_m=lever_body_m)
