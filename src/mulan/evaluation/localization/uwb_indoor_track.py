"""The Labyrinth robot of TU Chemnitz tracked by four anchors behind walls and its wheels."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.localization.site_tracking import (
    SITE,
    Antenna,
    placed,
    planar,
    site_keyframes,
    solved,
    tracking_graph,
)
from mulan.evaluation.localization.track_score import TrackErrors, track_errors
from mulan.evaluation.localization.uwb_planar_track import SiteTrackConfig, thinned
from mulan.evaluation.uwb.protocol import read_indoor, time_halves
from mulan.geometry import se3
from mulan.localization.keyframes import Keyframes
from mulan.wireless.range_fit import fit_range_model
from mulan.wireless.recordings.uwb_chemnitz import ROBOT, ChemnitzRun
from mulan.wireless.types import Range

_WHEEL_SIGMA_M_PER_S = 0.01  # as the recording states: variance 1e-4 of each wheel's speed
_FLOOR_M, _FLOOR_RAD = 1e-3, 1e-3
_TILT_SIGMA_RAD = np.deg2rad(0.5)
_PLACED_BY = 60  # ranges of the start that place the robot; the wheels hold for those seconds
_LINK_RATE_HZ = 8.0  # the recording's own rate: nothing is thinned away


def wheel_odometry(
    run: ChemnitzRun, time_s: Float[NDArray, "n"]
) -> tuple[Float[NDArray, "n 4 4"], Float[NDArray, "m 6 6"]]:
    """Dead reckoning at times from both wheels' speeds, and the covariance of each step.

    The recording's "wheel base" is half the track, and its first speed is the left wheel's: so read, and only
    so, the wheels alone draw the true path (5 cm RMS over 9 m).
    """
    left, right = (np.interp(time_s, run.odometry_time_s, speed) for speed in run.wheel_speed_m_per_s.T)
    step_s = np.diff(time_s)
    forward_m = 0.5 * (right + left)[:-1] * step_s
    turn_rad = ((right - left)[:-1] / (2 * run.wheel_base_m)) * step_s
    poses = [np.eye(4)]
    for metres, turn in zip(forward_m, turn_rad, strict=True):
        step = se3.exp(np.array([0.0, 0.0, turn, metres, 0.0, 0.0]))
        poses.append(poses[-1] @ step)
    covariance = np.zeros((len(step_s), 6, 6))
    covariance[:, [0, 1], [0, 1]] = 2 * _TILT_SIGMA_RAD**2
    covariance[:, 2, 2] = 2 * (_WHEEL_SIGMA_M_PER_S / (2 * run.wheel_base_m) * step_s) ** 2 + _FLOOR_RAD**2
    covariance[:, 3, 3] = (_WHEEL_SIGMA_M_PER_S * step_s) ** 2 / 2 + _FLOOR_M**2
    covariance[:, [4, 5], [4, 5]] = _FLOOR_M**2
    return np.array(poses), covariance


def track_indoor(name: str, run: ChemnitzRun, ranges: list[Range], config: SiteTrackConfig) -> TrackErrors:
    """The whole drive from ranges and wheels; the truth knows no heading."""
    ranges = sorted(ranges, key=lambda r: r.time_s)
    times = np.unique([r.time_s for r in ranges])
    T_odom, covariance = wheel_odometry(run, times)
    antennas = {
        link[0]: Antenna(SITE, np.array([*at, 0.0]))
        for link, at in zip(run.samples.links, run.range_anchor_m, strict=True)
    }
    antennas[ROBOT] = Antenna(ROBOT, np.zeros(3))
    at_time = dict(zip(times.tolist(), T_odom, strict=True))
    start = planar(*placed(antennas, ranges[:_PLACED_BY], at_time, None))
    bodies = {
        SITE: site_keyframes(),
        ROBOT: Keyframes(ROBOT, times, T_odom, covariance, np.full(len(times), _TILT_SIGMA_RAD**2)),
    }
    graph = tracking_graph(bodies, antennas, ranges, config.localization)
    tracked = solved(graph, {ROBOT: start @ T_odom})[ROBOT]
    true_m = np.stack([np.interp(times, run.samples.time_s, run.position_m[:, k]) for k in (0, 1)], 1)
    return track_errors(name, tracked, true_m, None)


def indoor_tracks(data: Path, config: SiteTrackConfig) -> tuple[TrackErrors, TrackErrors]:
    """The drive with each half's ranges calibrated by laws fitted to the other half, and uncalibrated.

    Raises:
        InputError: A file is missing or damaged.
    """
    run = read_indoor(data / "uwb_indoor_chemnitz")
    halves = time_halves(run.samples)
    calibrated: list[Range] = []
    for half, other in (halves, halves[::-1]):
        calibrated += thinned(half, fit_range_model(other, config.fit), _LINK_RATE_HZ, free=False)
    plain = thinned(run.samples, None, _LINK_RATE_HZ)
    return track_indoor("calibrated", run, calibrated, config), track_indoor("plain", run, plain, config)
