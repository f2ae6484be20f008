"""The paper's scheme: one initial range and angle, odometry after that (readings, row 14)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range


def _direction(bearings: Sequence[Bearing], observer: str, peer: str) -> Bearing | None:
    return next((b for b in bearings if (b.observer, b.peer) == (observer, peer)), None)


def initial_fix(
    anchor: RobotLog, robot: RobotLog, bearings: Sequence[Bearing], ranges: Sequence[Range]
) -> Float[NDArray, "4 4"] | None:
    """``T_anchorodom_robotodom`` from the first mutual bearing and the range beside it; None without them.

    One angle and one range give no yaw (the paper assumes it); here the robot's own bearing back to the
    anchor gives it, which is to the scheme's advantage. Each bearing's best hypothesis is taken.
    """
    seen = _direction(bearings, anchor.name, robot.name)
    back = _direction(bearings, robot.name, anchor.name)
    of_pair = [r for r in ranges if {r.observer, r.peer} == {anchor.name, robot.name}]
    if seen is None or back is None or not of_pair:
        return None
    range_m = min(of_pair, key=lambda r: abs(r.time_s - seen.time_s)).range_m
    here, there = (
        se3.interpolate(log.odometry.time_s, log.odometry.T_odom_body, np.array([t]))[0][:3, 3]
        for log, t in ((anchor, seen.time_s), (robot, seen.peer_time_s))
    )
    out, home = seen.direction_odom[0], -back.direction_odom[0]
    yaw = np.arctan2(out[1], out[0]) - np.arctan2(home[1], home[0])
    R = so3.about_z(np.array(yaw))
    return se3.from_parts(R, here + range_m * out - R @ there)
