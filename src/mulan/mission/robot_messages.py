"""One robot's log as ROS messages, each with its time in nanoseconds."""

from typing import Any

import numpy as np
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission import messages, ros_camera, ros_poses
from mulan.mission.messages import RobotFrames, Topic
from mulan.mission.ros_poses import T_OPTICAL_OPENGL
from mulan.mission.ros_stamps import to_nanoseconds, to_stamp
from mulan.mission.types import CsiTrack, HeldOutViews, OdometryTrack, Photo, RangeTrack, RobotLog

Header = ros.std_msgs__msg__Header
Stamped = list[tuple[int, Any]]


def of_robot(log: RobotLog) -> dict[Topic, Stamped]:
    """Every message of one robot by topic, calibration and mounts apart.

    Raises:
        ValueError: A time does not fit a ROS stamp.
    """
    frames = RobotFrames(log.name)
    found: dict[Topic, Stamped] = {
        messages.IMAGE: _images(log.photos, frames.camera_optical),
        messages.ODOMETRY: _odometry(log.odometry, frames),
    }
    csi = [message for track in log.csi.values() for message in _csi(track, frames.wifi_antenna)]
    if csi:
        found[messages.CSI] = csi
    ranges = [message for track in log.ranges.values() for message in _ranges(track, frames.uwb_antenna)]
    if ranges:
        found[messages.RANGE] = ranges
    if log.ground_truth is not None:
        found[messages.GROUND_TRUTH] = _poses(log.ground_truth.time_s, log.ground_truth.T_world_body)
    return found


def of_held_out(views: HeldOutViews) -> dict[Topic, Stamped]:
    """Test photographs and the true poses of their camera's optical frame.

    Raises:
        ValueError: A time does not fit a ROS stamp.
    """
    times_s = np.array([photo.time_s for photo in views.photos], dtype=float)
    return {
        messages.IMAGE: _images(views.photos, RobotFrames(messages.HELD_OUT).camera_optical),
        messages.GROUND_TRUTH: _poses(times_s, views.T_world_camera @ T_OPTICAL_OPENGL),
    }


def mounts(log: RobotLog, stamp: Any) -> list[Any]:
    """Where camera and antennas sit on the body, as stamped transforms."""
    frames = RobotFrames(log.name)
    children = {
        frames.camera_optical: log.T_body_camera @ T_OPTICAL_OPENGL,
        frames.wifi_antenna: se3.from_parts(np.eye(3), log.wifi_antenna_body_m),
        frames.uwb_antenna: se3.from_parts(np.eye(3), log.uwb_antenna_body_m),
    }
    return [
        ros.geometry_msgs__msg__TransformStamped(Header(stamp, frames.body), child, ros_poses.to_transform(T))
        for child, T in children.items()
    ]


def calibration(name: str, camera: PinholeCamera, stamp: Any) -> Any:
    """One camera's calibration."""
    return ros_camera.to_camera_info(camera, Header(stamp, RobotFrames(name).camera_optical))


def _header(time_s: float, frame: str) -> tuple[int, Any]:
    time_ns = to_nanoseconds(time_s)
    return time_ns, Header(to_stamp(time_ns), frame)


def _images(photos: tuple[Photo, ...], frame: str) -> Stamped:
    stamped = []
    for photo in photos:
        time_ns, header = _header(photo.time_s, frame)
        data = np.frombuffer(photo.data, np.uint8)
        stamped.append((time_ns, ros.sensor_msgs__msg__CompressedImage(header, photo.encoding, data)))
    return stamped


def _odometry(track: OdometryTrack, frames: RobotFrames) -> Stamped:
    if track.covariance is None:
        covariances = np.zeros((len(track.time_s), 36))
    else:
        covariances = ros_poses.covariance_to_ros(track.T_odom_body, track.covariance).reshape(-1, 36)
    zero = ros.geometry_msgs__msg__Vector3(0.0, 0.0, 0.0)
    twist = ros.geometry_msgs__msg__TwistWithCovariance(
        ros.geometry_msgs__msg__Twist(zero, zero), np.zeros(36)
    )
    stamped = []
    for time_s, T, covariance in zip(track.time_s, track.T_odom_body, covariances, strict=True):
        time_ns, header = _header(float(time_s), frames.odom)
        pose = ros.geometry_msgs__msg__PoseWithCovariance(ros_poses.to_pose(T), covariance)
        stamped.append((time_ns, ros.nav_msgs__msg__Odometry(header, frames.body, pose, twist)))
    return stamped


def _csi(track: CsiTrack, frame: str) -> Stamped:
    make: Any = messages.typestore().types[messages.CSI_TYPE]
    stamped = []
    for time_s, counter, channel in zip(track.time_s, track.frame_counter, track.channel, strict=True):
        time_ns, header = _header(float(time_s), frame)
        real, imag = channel.real.astype(np.float32).ravel(), channel.imag.astype(np.float32).ravel()
        message = make(header, track.peer, int(counter), len(channel), track.subcarrier_hz, real, imag)
        stamped.append((time_ns, message))
    return stamped


def _ranges(track: RangeTrack, frame: str) -> Stamped:
    make: Any = messages.typestore().types[messages.RANGE_TYPE]
    stamped = []
    for time_s, range_m, sigma_m in zip(track.time_s, track.range_m, track.sigma_m, strict=True):
        time_ns, header = _header(float(time_s), frame)
        stamped.append((time_ns, make(header, track.peer, float(range_m), float(sigma_m))))
    return stamped


def _poses(times_s: np.ndarray, T: np.ndarray) -> Stamped:
    stamped = []
    for time_s, T_world_child in zip(times_s, T, strict=True):
        time_ns, header = _header(float(time_s), "world")
        pose = ros_poses.to_pose(T_world_child)
        stamped.append((time_ns, ros.geometry_msgs__msg__PoseStamped(header, pose)))
    return stamped
