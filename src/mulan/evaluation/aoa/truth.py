"""Where a link's source really lies, seen from the points a bearing may refer to."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.wireless.link_bearing import DisplacementSource, displacement_track
from mulan.wireless.recordings.wsr import WsrLink, WsrRun

DEFINITIONS = {
    "origin": "azimuth from the point the bearing says it starts from (centroid of the antenna path), taken "
    "to the motion-capture frame, to the source; the yaw between the odometry's and the motion-capture "
    "axes is not removed and so is part of the error",
    "start": "azimuth from the first moved sample to the source, as in reference.csv",
    "own_axes": "as origin, but in the odometry's own axes: the yaw between the frames is removed",
}


@dataclass(frozen=True)
class TrueAzimuth:
    """True azimuths [rad] of a link, as ``DEFINITIONS`` tells."""

    origin_rad: float
    start_rad: float
    own_axes_rad: float


def true_azimuth(
    run: WsrRun, link: WsrLink, source: DisplacementSource, origin_odom_m: Float[NDArray, "3"]
) -> TrueAzimuth:
    """The truths of one link; motion capture is used here only, never by an estimator."""
    begin, end = run.motion_s
    time_s = np.linspace(begin, end, 400)
    track = displacement_track(run, source)
    estimated, true = (
        np.interp(time_s, stamps, position[:, 0]) + 1j * np.interp(time_s, stamps, position[:, 1])
        for stamps, position in (
            (track.time_s, track.T_odom_body[:, :3, 3]),
            (run.mocap.time_s, run.mocap.position_m),
        )
    )
    yaw = np.angle(np.vdot(estimated - estimated.mean(), true - true.mean()))
    origin = (origin_odom_m[0] + 1j * origin_odom_m[1] - estimated.mean()) * np.exp(1j * yaw) + true.mean()
    peer = link.source_position_m[0] + 1j * link.source_position_m[1]
    start = run.start_m[0] + 1j * run.start_m[1]
    from_origin = np.angle(peer - origin)
    return TrueAzimuth(float(from_origin), float(np.angle(peer - start)), float(from_origin - yaw))
