"""Poses and pose covariances in ROS's conventions and in ours."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from rosbags.typesys.stores import ros2_jazzy as ros

from mulan.geometry import se3, so3
from mulan.geometry.camera import R_OPTICAL_OPENGL

Point, Quaternion = ros.geometry_msgs__msg__Point, ros.geometry_msgs__msg__Quaternion
Vector3, Transform = ros.geometry_msgs__msg__Vector3, ros.geometry_msgs__msg__Transform
Pose = ros.geometry_msgs__msg__Pose

# the same matrix both ways: it turns half a circle about x
T_OPTICAL_OPENGL = se3.from_parts(R_OPTICAL_OPENGL, np.zeros(3))
UNIT_TOLERANCE = 1e-3  # of a quaternion's norm: files with four decimals pass, anything worse is a fault


def to_pose(T: Float[NDArray, "4 4"]) -> Pose:
    """ROS pose of a rigid transform."""
    x, y, z, w = (float(c) for c in so3.to_quaternion(T[:3, :3]))
    return Pose(Point(*(float(c) for c in T[:3, 3])), Quaternion(x, y, z, w))


def to_transform(T: Float[NDArray, "4 4"]) -> Transform:
    """ROS transform of a rigid transform."""
    x, y, z, w = (float(c) for c in so3.to_quaternion(T[:3, :3]))
    return Transform(Vector3(*(float(c) for c in T[:3, 3])), Quaternion(x, y, z, w))


def to_matrices(
    position: Float[NDArray, "n 3"], quaternion_xyzw: Float[NDArray, "n 4"]
) -> Float[NDArray, "n 4 4"]:
    """Rigid transforms of positions and quaternions.

    Raises:
        ValueError: A number is not finite or a quaternion is not of unit length; the message says which row.
    """
    finite = np.isfinite(position).all(1) & np.isfinite(quaternion_xyzw).all(1)
    if not finite.all():
        raise ValueError(f"pose {int(np.argmin(finite))} holds NaN or infinity")
    norm = np.linalg.norm(quaternion_xyzw, axis=1)
    unit = np.abs(norm - 1) <= UNIT_TOLERANCE
    if not unit.all():
        bad = int(np.argmin(unit))
        raise ValueError(f"the quaternion of pose {bad} has length {norm[bad]:.4g} instead of 1")
    return se3.from_parts(so3.from_quaternion(quaternion_xyzw), position)


def covariance_to_ros(
    T: Float[NDArray, "*b 4 4"], covariance: Float[NDArray, "*b 6 6"]
) -> Float[NDArray, "*b 6 6"]:
    """Covariance over (x, y, z, rotations about the parent's fixed axes), as ``PoseWithCovariance`` has it.

    ``T exp(w, v)`` moves the origin by R v and turns by R w in the parent's axes (first order).
    """
    J = _ros_from_tangent(T)
    return J @ covariance @ np.swapaxes(J, -1, -2)


def covariance_from_ros(
    T: Float[NDArray, "*b 4 4"], covariance_ros: Float[NDArray, "*b 6 6"]
) -> Float[NDArray, "*b 6 6"]:
    """The inverse of :func:`covariance_to_ros`: right perturbation, (rotation rad, translation m)."""
    J = np.swapaxes(_ros_from_tangent(T), -1, -2)  # orthogonal
    return J @ covariance_ros @ np.swapaxes(J, -1, -2)


def check_covariance(covariance: Float[NDArray, "n 6 6"]) -> Float[NDArray, "n 6 6"]:
    """Covariances made exactly symmetric.

    Raises:
        ValueError: One is not finite, not symmetric or has a negative eigenvalue; the message says which row.
    """
    finite = np.isfinite(covariance).all((1, 2))
    if not finite.all():
        raise ValueError(f"covariance {int(np.argmin(finite))} holds NaN or infinity")
    symmetric = (covariance + np.swapaxes(covariance, 1, 2)) / 2
    scale = np.abs(covariance).max((1, 2))
    asymmetry = np.abs(covariance - symmetric).max((1, 2))
    negative = -np.linalg.eigvalsh(symmetric)[:, 0]
    good = (asymmetry <= 1e-6 * scale) & (negative <= 1e-6 * scale)
    if not good.all():
        raise ValueError(f"covariance {int(np.argmin(good))} is not symmetric and positive semi-definite")
    return symmetric


def _ros_from_tangent(T: Float[NDArray, "*b 4 4"]) -> Float[NDArray, "*b 6 6"]:
    J = np.zeros((*T.shape[:-2], 6, 6))
    J[..., :3, 3:] = J[..., 3:, :3] = T[..., :3, :3]
    return J
