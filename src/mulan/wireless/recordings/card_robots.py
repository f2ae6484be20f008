"""Two card files and an antenna path as the logs of a robot that moved and one that stood still."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission.tum import read_tum
from mulan.mission.types import CsiTrack, OdometryTrack, RobotLog
from mulan.wireless.recordings.further_chips import CsiFileOptions, read_csi_file

MOVING, STATIC = "moving", "static"
_NO_CAMERA = PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5)
_FEWEST_POSES = 2


def card_robots(
    file: Path, reply_file: Path, path_file: Path, card: CsiFileOptions, reply_card: CsiFileOptions
) -> tuple[RobotLog, RobotLog]:
    """Logs of the moving and of the static robot.

    Args:
        file: What the moving robot's card received, of any supported chip.
        reply_file: What the static robot's card received, on its own clock.
        path_file: Poses of the moving robot's antenna as TUM text, on the clock of ``file``.
        card: What ``file`` does not say of itself; the names of peers are given here.
        reply_card: The same for ``reply_file``; its carrier is that of ``card`` unless given.

    Raises:
        InputError: A file cannot be read, or the path and the packets have no time in common.
    """
    path = read_tum(path_file)
    forward = read_csi_file(file, replace(card, peer=STATIC))
    carrier_hz = card.carrier_hz if reply_card.carrier_hz is None else reply_card.carrier_hz
    reverse = read_csi_file(reply_file, replace(reply_card, peer=MOVING, carrier_hz=carrier_hz))
    if len(path.time_s) < _FEWEST_POSES:
        raise InputError(path_file, "poses", "there is only one", "record the whole motion")
    packets_s = forward.time_s
    if path.time_s[-1] < packets_s.min() or path.time_s[0] > packets_s.max():
        raise InputError(
            path_file,
            "time",
            f"{path.time_s[0]:.3f} to {path.time_s[-1]:.3f} s has nothing in common with the packets of "
            f"{file}, {packets_s.min():.3f} to {packets_s.max():.3f} s",
            "give the path on that card's clock",
        )
    still = OdometryTrack(np.sort(reverse.time_s)[[0, -1]], np.tile(np.eye(4), (2, 1, 1)), None)
    moving = OdometryTrack(path.time_s, path.T_world_body, None)
    return _robot(MOVING, moving, forward), _robot(STATIC, still, reverse)


def _robot(name: str, odometry: OdometryTrack, csi: CsiTrack) -> RobotLog:
    # the path is the antenna's own, so there is no lever arm
    return RobotLog(name, _NO_CAMERA, np.eye(4), np.zeros(3), np.zeros(3), (), odometry, {csi.peer: csi}, {})
