"""Messages of one topic as the arrays of one track, checked."""

from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera
from mulan.mission import messages, pixels, ros_camera, ros_poses
from mulan.mission.bag_topics import BagTopics
from mulan.mission.ros_stamps import stamp_s
from mulan.mission.types import OdometryTrack, Photo, PoseTrack, RangeTrack


def camera(bag: BagTopics, namespace: str) -> PinholeCamera:
    """The first calibration of a camera.

    Raises:
        InputError: There is none, or it is not one of a pinhole camera.
    """
    topic = messages.CAMERA_INFO.of(namespace)
    found = bag.of(topic)
    if not found:
        raise bag.error(
            topic, "has no message, so the camera's intrinsics are unknown", "record it with the images"
        )
    try:
        return ros_camera.from_camera_info(found[0])
    except ValueError as error:
        raise bag.error(topic, str(error), "calibrate the camera with a pinhole model") from error


def photos(bag: BagTopics, namespace: str, intrinsics: PinholeCamera) -> tuple[Photo, ...]:
    """Photographs as sent.

    Raises:
        InputError: One is neither PNG nor JPEG, or not of the calibrated size.
    """
    topic = messages.IMAGE.of(namespace)
    result = []
    for message in bag.of(topic):
        data = message.data.tobytes()
        encoding = pixels.encoding_of(data)
        if encoding is None:
            raise bag.error(
                topic,
                f"an image of format '{message.format}' is neither PNG nor JPEG",
                "record one of the two",
            )
        width, height = pixels.image_size(data, f"{bag.source}: topic {topic}")
        if (width, height) != (intrinsics.width, intrinsics.height):
            raise bag.error(
                topic,
                f"an image of {width}x{height} pixels does not fit the"
                f" {intrinsics.width}x{intrinsics.height} of {messages.CAMERA_INFO.of(namespace)}",
                "record images and calibration at one size",
            )
        result.append(Photo(stamp_s(message), encoding, data))
    return tuple(result)


def odometry(bag: BagTopics, robot: str) -> OdometryTrack:
    """Dead reckoning; covariances that are zero throughout mean that the driver gives none.

    Raises:
        InputError: There is no message, a pose is not finite or not a rotation, or a covariance is not one.
    """
    topic = messages.ODOMETRY.of(robot)
    found = bag.of(topic)
    if not found:
        raise bag.error(topic, "has no messages", "record the robot's odometry")
    T = _matrices(bag, topic, [message.pose.pose for message in found])
    covariance_ros = np.array([message.pose.covariance for message in found], dtype=float).reshape(-1, 6, 6)
    covariance = None
    if covariance_ros.any():
        try:
            checked = ros_poses.check_covariance(covariance_ros)
        except ValueError as error:
            raise bag.error(
                topic, str(error), "publish a valid pose covariance, or zeros for none"
            ) from error
        covariance = ros_poses.covariance_from_ros(T, checked)
    return OdometryTrack(_times(found), T, covariance)


def ranges(bag: BagTopics, robot: str) -> dict[str, RangeTrack]:
    """UWB ranges by peer.

    Raises:
        InputError: A range is not finite or its sigma not positive.
    """
    topic = messages.RANGE.of(robot)
    result = {}
    for peer, found in by_peer(bag.of(topic)).items():
        range_m = np.array([message.range_m for message in found], dtype=float)
        sigma_m = np.array([message.sigma_m for message in found], dtype=float)
        if not (np.isfinite(range_m).all() and np.isfinite(sigma_m).all()):
            raise bag.error(topic, f"a range to '{peer}' holds NaN or infinity", "leave failed ranges out")
        if not (sigma_m > 0).all():
            raise bag.error(
                topic, f"sigma_m to '{peer}' is not positive", "publish the sensor's standard deviation"
            )
        result[peer] = RangeTrack(peer, _times(found), range_m, sigma_m)
    return result


def poses(bag: BagTopics, namespace: str) -> PoseTrack | None:
    """True poses, or None where the topic is absent or empty.

    Raises:
        InputError: A pose is not finite or not a rotation.
    """
    topic = messages.GROUND_TRUTH.of(namespace)
    found = bag.of(topic)
    if not found:
        return None
    return PoseTrack(_times(found), _matrices(bag, topic, [message.pose for message in found]))


def by_peer(found: list[Any]) -> dict[str, list[Any]]:
    """Messages grouped by the peer they name, in order of first appearance."""
    groups: dict[str, list[Any]] = {}
    for message in found:
        groups.setdefault(message.peer, []).append(message)
    return groups


def _times(found: list[Any]) -> Float[NDArray, "n"]:
    return np.array([stamp_s(message) for message in found], dtype=float)


def _matrices(bag: BagTopics, topic: str, found: list[Any]) -> Float[NDArray, "n 4 4"]:
    position = np.array([[p.position.x, p.position.y, p.position.z] for p in found], dtype=float)
    quaternion = np.array(
        [[p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w] for p in found], dtype=float
    )
    try:
        return ros_poses.to_matrices(position, quaternion)
    except ValueError as error:
        raise bag.error(topic, str(error), "record valid poses or leave failed ones out") from error
