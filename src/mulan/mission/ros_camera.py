"""``sensor_msgs/CameraInfo`` and our pinhole camera."""

from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.geometry.camera import PinholeCamera

CameraInfo, Header = ros.sensor_msgs__msg__CameraInfo, ros.std_msgs__msg__Header
RegionOfInterest = ros.sensor_msgs__msg__RegionOfInterest

# OpenCV, hence ROS, puts the centre of pixel (0, 0) at (0, 0); we put it at (0.5, 0.5)
PIXEL_CENTRE = 0.5


def to_camera_info(camera: PinholeCamera, header: Header) -> CameraInfo:
    """The camera as ROS calibration (plumb_bob, unrectified)."""
    cx, cy = camera.cx - PIXEL_CENTRE, camera.cy - PIXEL_CENTRE
    K = np.array([camera.fx, 0, cx, 0, camera.fy, cy, 0, 0, 1], dtype=float)
    P = np.array([camera.fx, 0, cx, 0, 0, camera.fy, cy, 0, 0, 0, 1, 0], dtype=float)
    return CameraInfo(
        header=header,
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=np.array(camera.distortion, dtype=float),
        k=K,
        r=np.eye(3).ravel(),
        p=P,
        binning_x=0,
        binning_y=0,
        roi=RegionOfInterest(0, 0, 0, 0, False),
    )


def from_camera_info(message: Any) -> PinholeCamera:
    """The camera of a ROS calibration.

    Raises:
        ValueError: It is uncalibrated, skewed, binned, or of a lens model other than plumb_bob.
    """
    K = np.asarray(message.k, dtype=float).reshape(3, 3)
    D = np.asarray(message.d, dtype=float)
    if not (np.isfinite(K).all() and np.isfinite(D).all()):
        raise ValueError("K or D holds NaN or infinity")
    if K[0, 0] <= 0 or K[1, 1] <= 0 or message.width == 0 or message.height == 0:
        raise ValueError("the camera is not calibrated (zero focal length or size)")
    # rational_polynomial with its last three terms zero is plumb_bob
    if D[5:].any() or (D.any() and message.distortion_model not in ("plumb_bob", "rational_polynomial")):
        raise ValueError(f"lens model '{message.distortion_model}' is not supported, only plumb_bob")
    if K[0, 1] != 0:
        raise ValueError("K has a skew term")
    if message.binning_x > 1 or message.binning_y > 1 or message.roi.width or message.roi.height:
        raise ValueError("binning and regions of interest are not supported")
    k1, k2, p1, p2, k3 = (float(c) for c in np.concatenate([D[:5], np.zeros(5)])[:5])
    return PinholeCamera(
        width=int(message.width),
        height=int(message.height),
        fx=float(K[0, 0]),
        fy=float(K[1, 1]),
        cx=float(K[0, 2]) + PIXEL_CENTRE,
        cy=float(K[1, 2]) + PIXEL_CENTRE,
        k1=k1,
        k2=k2,
        p1=p1,
        p2=p2,
        k3=k3,
    )
