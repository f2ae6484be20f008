"""Every sensor of every robot, listening along the true motions: the Mission that comes out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import CsiTrack, HeldOutViews, Mission, Photo, PoseTrack, RangeTrack, RobotLog
from mulan.simulation.odometry import OdometryNoiseConfig, simulate_odometry
from mulan.simulation.propagation import Propagation
from mulan.simulation.radio import RadioConfig, simulate_csi
from mulan.simulation.timeline import RobotMotion, TourConfig, plan_motions
from mulan.simulation.tour import view_path
from mulan.simulation.uwb import UwbConfig, simulate_ranges

ROBOT_NAMES = ("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa")

# body: x forward along the view, y left, z up in the image; camera: x right, y up, z backward (OpenGL)
T_BODY_CAMERA = np.array(
    [[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
WIFI_ANTENNA_BODY_M = np.array([0.0, 0.0, 0.08])
UWB_ANTENNA_BODY_M = np.array([0.05, 0.0, 0.05])


@dataclass(frozen=True)
class SensorConfig:
    """All sensors but the camera."""

    odometry: OdometryNoiseConfig = field(default_factory=OdometryNoiseConfig)
    """Dead reckoning."""
    radio: RadioConfig = field(default_factory=RadioConfig)
    """WiFi channel state."""
    uwb: UwbConfig = field(default_factory=UwbConfig)
    """UWB ranges."""


@dataclass(frozen=True)
class CameraTour:
    """What one robot photographs, in order.

    Attributes:
        camera: Intrinsics.
        T_world_camera: True camera poses (OpenGL axes).
        encoding: "jpeg" or "png".
        images: Compressed files, one a pose.
    """

    camera: PinholeCamera
    T_world_camera: Float[NDArray, "n 4 4"]
    encoding: str
    images: tuple[bytes, ...]


def robot_names(count: int, source: str) -> tuple[str, ...]:
    """Names of the first robots.

    Raises:
        InputError: Fewer than one robot or more than there are names.
    """
    if not 1 <= count <= len(ROBOT_NAMES):
        raise InputError(
            source, "robots", f"{count} is not within 1..{len(ROBOT_NAMES)}", "choose another number"
        )
    return ROBOT_NAMES[:count]


def body_poses(T_world_camera: Float[NDArray, "n 4 4"]) -> Float[NDArray, "n 4 4"]:
    """Bodies that carry the given cameras."""
    return T_world_camera @ se3.inverse(T_BODY_CAMERA)


def plan_camera_tours(tours: Sequence[CameraTour], config: TourConfig) -> tuple[RobotMotion, ...]:
    """True motions of robots that take the given photographs."""
    metres_per_radian = config.speed_m_per_s / config.turn_rate_rad_per_s
    paths = [view_path(body_poses(tour.T_world_camera), metres_per_radian) for tour in tours]
    return plan_motions(paths, config)


def record_mission(
    tours: Sequence[CameraTour],
    motions: Sequence[RobotMotion],
    propagation: Propagation,
    sensors: SensorConfig,
    held_out: HeldOutViews | None,
    seed: int,
) -> Mission:
    """Let every robot record its tour.

    WiFi is recorded at both ends while either of the two makes its antenna motion, UWB all the time.

    Args:
        tours: What each robot photographs.
        motions: Its true motion past these views.
        propagation: What carries the radio.
        sensors: Noise of all sensors.
        held_out: Test views to pass along.
        seed: Source of all randomness; robots and pairs draw from streams of their own.
    """
    names = robot_names(len(tours), "mission")
    csi: dict[str, dict[str, CsiTrack]] = {name: {} for name in names}
    ranges: dict[str, dict[str, RangeTrack]] = {name: {} for name in names}
    for a, b in combinations(range(len(names)), 2):
        pair = (names[a], names[b])
        rng_csi, rng_uwb = (np.random.default_rng([seed, kind, a, b]) for kind in (1, 2))
        intervals_s = np.concatenate([motions[a].aperture_s, motions[b].aperture_s])
        intervals_s = intervals_s[np.argsort(intervals_s[:, 0])]
        wifi = (_antenna(motions[a], WIFI_ANTENNA_BODY_M), _antenna(motions[b], WIFI_ANTENNA_BODY_M))
        at_a, at_b = simulate_csi(pair, wifi, intervals_s, propagation, sensors.radio, rng_csi)
        csi[pair[0]][pair[1]], csi[pair[1]][pair[0]] = at_a, at_b
        uwb = (_antenna(motions[a], UWB_ANTENNA_BODY_M), _antenna(motions[b], UWB_ANTENNA_BODY_M))
        to_b, to_a = simulate_ranges(pair, uwb, motions[a].end_s, sensors.uwb, rng_uwb)
        ranges[pair[0]][pair[1]], ranges[pair[1]][pair[0]] = to_b, to_a

    robots = []
    for index, (name, tour, motion) in enumerate(zip(names, tours, motions, strict=True)):
        time_s = motion.sample_times()
        T_world_body = motion.pose(time_s)
        rng = np.random.default_rng([seed, 0, index])
        robots.append(
            RobotLog(
                name=name,
                camera=tour.camera,
                T_body_camera=T_BODY_CAMERA,
                wifi_antenna_body_m=WIFI_ANTENNA_BODY_M,
                uwb_antenna_body_m=UWB_ANTENNA_BODY_M,
                photos=tuple(
                    Photo(float(stamp), tour.encoding, data)
                    for stamp, data in zip(motion.photo_time_s, tour.images, strict=True)
                ),
                odometry=simulate_odometry(time_s, T_world_body, sensors.odometry, rng),
                csi=csi[name],
                ranges=ranges[name],
                ground_truth=PoseTrack(time_s, T_world_body),
            )
        )
    return Mission(tuple(robots), held_out)


def _antenna(
    motion: RobotMotion, lever_body_m: Float[NDArray, "3"]
) -> Callable[[Float[NDArray, "n"]], Float[NDArray, "n 3"]]:
    return partial(motion.point, lever_body_m=lever_body_m)
