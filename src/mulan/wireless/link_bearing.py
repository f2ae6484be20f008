"""The bearing of one recorded link, the moving robot's path taken from a chosen source."""

from dataclasses import replace
from enum import Enum

import numpy as np

from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import CsiTrack, OdometryTrack, RobotLog
from mulan.wireless.apertures import Aperture, antenna_path
from mulan.wireless.bearing import BearingConfig, bearing_of_aperture
from mulan.wireless.channel import pair_packets
from mulan.wireless.dead_reckoning import wheels_along_heading
from mulan.wireless.link_faults import faults_during
from mulan.wireless.recordings.wsr import WsrLink, WsrRun
from mulan.wireless.types import Bearing

_NO_CAMERA = PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5)

WSR_ANTENNA_BASE_M = np.array([0.0376, 0.1631, 0.0])
"""Antenna in the wheels' frame of the WSR robot: one constant fitted over the 30 runs of LOS_Set_A against
motion capture. With it the path is right to 1.2 mm RMS there; the T265's own positions to 13 mm."""

T265_FRAME_YAW_SIGMA_RAD, T265_SCALE_SIGMA = 0.043, 0.05
"""Of a T265 that has just been started: turn of its path against the true one, and scale (LOS_Set_A)."""
HEADING_FRAME_YAW_SIGMA_RAD = 0.022
"""Of its heading alone (LOS_Set_A): how well the robot was set down along the motion-capture axes."""


class DisplacementSource(Enum):
    """Where the moving antenna's path comes from."""

    MOCAP = "mocap"
    T265 = "t265"
    T265_WHEELS = "t265_wheels"
    ODOMETRY = "odometry"


def displacement_track(run: WsrRun, source: DisplacementSource) -> OdometryTrack:
    """The path of the moving robot; motion capture gives positions only, so its attitude counts as fixed."""
    if source is DisplacementSource.T265:
        # a ground robot stays on its floor; the few centimetres of height the T265 reports are its drift
        T = run.t265.T_odom_body.copy()
        T[:, 2, 3] = T[:, 2, 3].mean()
        return replace(run.t265, T_odom_body=T)
    if source is DisplacementSource.T265_WHEELS:
        return wheels_along_heading(run.t265, run.odometry, WSR_ANTENNA_BASE_M)
    if source is DisplacementSource.ODOMETRY:
        return run.odometry
    T = np.tile(np.eye(4), (len(run.mocap.time_s), 1, 1))
    T[:, :3, 3] = run.mocap.position_m
    return OdometryTrack(run.mocap.time_s, T, None)


def _robot(name: str, odometry: OdometryTrack, csi: CsiTrack) -> RobotLog:
    # the recordings give the antenna's path itself, so there is no lever arm
    return RobotLog(name, _NO_CAMERA, np.eye(4), np.zeros(3), np.zeros(3), (), odometry, {csi.peer: csi}, {})


def link_aperture(
    run: WsrRun, link: WsrLink, source: DisplacementSource, undo_phase_jumps: bool = False
) -> tuple[Aperture, RobotLog]:
    """All packets of the motion as one aperture, with the log of the robot that moved.

    Raises:
        InputError: A direction is dead or nothing can be paired.
    """
    observer = _robot(link.reverse.peer, displacement_track(run, source), link.forward)
    stamps = link.reverse.time_s[[0, -1]]
    peer = _robot(link.name, OdometryTrack(stamps, np.tile(np.eye(4), (2, 1, 1)), None), link.reverse)
    pairs = pair_packets(observer, peer, undo_phase_jumps)
    track = observer.odometry.time_s
    begin, end = max(run.motion_s[0], track[0]), min(run.motion_s[1], track[-1])
    index = np.flatnonzero((pairs.time_s >= begin) & (pairs.time_s <= end))
    time_s = pairs.time_s[index]
    reference = len(index) // 2
    aperture = Aperture(
        observer=pairs.observer,
        peer=pairs.peer,
        time_s=time_s,
        peer_time_s=pairs.peer_time_s[index],
        position_odom_m=antenna_path(observer.odometry, observer.wifi_antenna_body_m, time_s),
        channel=pairs.channel[index],
        wavelength_m=pairs.wavelength_m,
        reference=reference,
        T_odom_body=se3.interpolate(track, observer.odometry.T_odom_body, time_s[[reference]])[0]
        if len(index)
        else np.eye(4),
        faults=faults_during(pairs.faults, time_s) if len(index) else pairs.faults,
    )
    return aperture, observer


def link_bearing(
    run: WsrRun, link: WsrLink, source: DisplacementSource, config: BearingConfig
) -> Bearing | None:
    """The bearing from the moving robot to a static one; None where the path or the packets allow none.

    Raises:
        InputError: A direction is dead or nothing can be paired.
    """
    aperture, observer = link_aperture(run, link, source, config.undo_phase_jumps)
    if len(aperture.time_s) < config.aperture.fewest_packets:
        return None
    return bearing_of_aperture(aperture, observer, None, _for_source(config, source))


def _for_source(config: BearingConfig, source: DisplacementSource) -> BearingConfig:
    """The options with what is known about a source's frame and scale; motion capture needs nothing more."""
    if source is DisplacementSource.MOCAP:
        return config
    frame_yaw_rad, scale_sigma = {
        DisplacementSource.T265: (T265_FRAME_YAW_SIGMA_RAD, T265_SCALE_SIGMA),
        DisplacementSource.T265_WHEELS: (HEADING_FRAME_YAW_SIGMA_RAD, config.level.path_scale_sigma),
        DisplacementSource.ODOMETRY: (T265_FRAME_YAW_SIGMA_RAD, T265_SCALE_SIGMA),
    }[source]
    level = replace(
        config.level,
        scatter_sigma_rad=float(np.hypot(config.level.scatter_sigma_rad, frame_yaw_rad)),
        path_scale_sigma=scale_sigma,
    )
    return replace(config, level=level)
