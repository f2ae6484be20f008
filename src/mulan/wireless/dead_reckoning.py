"""Antenna path from a heading, wheel steps and a lever arm: what each sensor of a ground robot knows best.

A visual-inertial tracker knows its heading to a fraction of a degree, but on a path of half a metre its
translation has not yet converged: errors of 5 to 20 % in scale, a centimetre and more in shape. Wheels know
the length of a step, not its direction. Turning the wheels' steps along the tracker's heading and adding the
antenna's lever arm joins the two (Borenstein, Everett, Feng, "Where am I?", 1996, section 1.3: gyrodometry).
"""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3
from mulan.mission.types import OdometryTrack


def heading_rad(T: Float[NDArray, "n 4 4"]) -> Float[NDArray, "n"]:
    """Unwrapped yaw of the body's x axis."""
    return np.unwrap(np.arctan2(T[:, 1, 0], T[:, 0, 0]))


def _turned(vector: Float[NDArray, "m 2"], angle_rad: Float[NDArray, "n"]) -> Float[NDArray, "n 2"]:
    """Plane vectors turned by angles; a single vector is turned by each of them."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([cos * vector[:, 0] - sin * vector[:, 1], sin * vector[:, 0] + cos * vector[:, 1]], 1)


def wheels_along_heading(
    heading: OdometryTrack, wheels: OdometryTrack, antenna_body_m: Float[NDArray, "3"]
) -> OdometryTrack:
    """The antenna's level path in the axes of the heading's source.

    Args:
        heading: Where the yaw is taken from; its translation is not used.
        wheels: Wheel odometry on the same clock; its own yaw is not used.
        antenna_body_m: Antenna in the wheels' body frame (x ahead, y to the left).

    Returns:
        Poses of the antenna at the heading's stamps, as far as the wheels were recorded; the wheels'
        first pose is the origin. It claims no covariance.

    Raises:
        ValueError: The two were not recorded at the same time.
    """
    inside = (heading.time_s >= wheels.time_s[0]) & (heading.time_s <= wheels.time_s[-1])
    if inside.sum() < 2:
        raise ValueError("heading and wheel odometry share no time")
    yaw = heading_rad(heading.T_odom_body)
    at_wheels = np.interp(wheels.time_s, heading.time_s, yaw)
    turn = at_wheels - heading_rad(wheels.T_odom_body)
    step = np.diff(wheels.T_odom_body[:, :2, 3], axis=0)
    base = np.cumsum(np.concatenate([np.zeros((1, 2)), _turned(step, (turn[1:] + turn[:-1]) / 2)]), axis=0)
    time_s, yaw = heading.time_s[inside], yaw[inside]
    x, y = (np.interp(time_s, wheels.time_s, base[:, axis]) for axis in (0, 1))
    antenna = np.stack([x, y], 1) + _turned(antenna_body_m[None, :2], yaw)
    position = np.column_stack([antenna, np.full(len(yaw), antenna_body_m[2])])
    return OdometryTrack(time_s, se3.from_parts(so3.about_z(yaw), position), None)
