"""What robots recorded: frozen records, one array per channel, clocks and frames in the names."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, UInt32
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera


@dataclass(frozen=True)
class Photo:
    """One compressed photograph as the robot sent it.

    Attributes:
        time_s: Exposure time on the robot's clock.
        encoding: "jpeg" or "png".
        data: The compressed file, byte for byte.
    """

    time_s: float
    encoding: str
    data: bytes


@dataclass(frozen=True)
class OdometryTrack:
    """Dead reckoning in the robot's own start frame.

    Attributes:
        time_s: Stamps on the robot's clock, increasing.
        T_odom_body: Body poses.
        covariance: Accumulated covariance of each pose since the start (right perturbation), or None where
            the driver gives none.
    """

    time_s: Float[NDArray, "n"]
    T_odom_body: Float[NDArray, "n 4 4"]
    covariance: Float[NDArray, "n 6 6"] | None


@dataclass(frozen=True)
class CsiTrack:
    """Channel state of every packet received from one peer.

    Attributes:
        peer: Name of the sender.
        time_s: Reception times on the receiver's clock.
        frame_counter: Counter shared by a packet and its reply; pairs the two directions.
        channel: Complex channel a packet, antenna and subcarrier.
        subcarrier_hz: Absolute frequency of each subcarrier.
    """

    peer: str
    time_s: Float[NDArray, "n"]
    frame_counter: UInt32[NDArray, "n"]
    channel: Complex[NDArray, "n antennas subcarriers"]
    subcarrier_hz: Float[NDArray, "subcarriers"]


@dataclass(frozen=True)
class RangeTrack:
    """UWB ranges to one peer.

    Attributes:
        peer: Name of the other robot.
        time_s: Stamps on the robot's clock.
        range_m: Antenna-to-antenna distance as reported.
        sigma_m: Standard deviation as reported.
    """

    peer: str
    time_s: Float[NDArray, "n"]
    range_m: Float[NDArray, "n"]
    sigma_m: Float[NDArray, "n"]


@dataclass(frozen=True)
class PoseTrack:
    """True body poses, for evaluation only; no estimator may read them."""

    time_s: Float[NDArray, "n"]
    T_world_body: Float[NDArray, "n 4 4"]


@dataclass(frozen=True)
class RobotLog:
    """Everything one robot recorded.

    Attributes:
        name: Topic namespace of the robot.
        camera: Intrinsics.
        T_body_camera: Camera pose in the body frame (OpenGL camera axes).
        wifi_antenna_body_m, uwb_antenna_body_m: Lever arms in the body frame.
        photos: In order of time.
        odometry: Dead reckoning.
        csi, ranges: By peer name.
        ground_truth: True poses if known.
    """

    name: str
    camera: PinholeCamera
    T_body_camera: Float[NDArray, "4 4"]
    wifi_antenna_body_m: Float[NDArray, "3"]
    uwb_antenna_body_m: Float[NDArray, "3"]
    photos: tuple[Photo, ...]
    odometry: OdometryTrack
    csi: Mapping[str, CsiTrack]
    ranges: Mapping[str, RangeTrack]
    ground_truth: PoseTrack | None = None

    @property
    def photo_time_s(self) -> Float[NDArray, "n"]:
        """Exposure times of all photographs."""
        return np.array([photo.time_s for photo in self.photos], dtype=float)


@dataclass(frozen=True)
class HeldOutViews:
    """Test photographs with true camera poses, never used for learning.

    Attributes:
        camera: Intrinsics.
        photos: The photographs.
        T_world_camera: True camera poses (OpenGL axes) in the frame of the ground truth.
    """

    camera: PinholeCamera
    photos: tuple[Photo, ...]
    T_world_camera: Float[NDArray, "n 4 4"]


@dataclass(frozen=True)
class Mission:
    """All robots of one mission, the first being the anchor whose start frame is the world."""

    robots: tuple[RobotLog, ...]
    held_out: HeldOutViews | None = None

    def robot(self, name: str) -> RobotLog:
        """The log of one robot.

        Raises:
            KeyError: No robot has that name.
        """
        for log in self.robots:
            if log.name == name:
                return log
        raise KeyError(name)
