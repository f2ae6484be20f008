"""A mission out of any posed image set: robots share the photographs and fly past where they were taken."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry.alignment import point_nearest_to_axes
from mulan.geometry.camera import PinholeCamera
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.types import HeldOutViews, Mission, Photo
from mulan.simulation.image_sources import RoomConfig
from mulan.simulation.propagation import Mirrors
from mulan.simulation.recording import (
    CameraTour,
    SensorConfig,
    plan_camera_tours,
    record_mission,
    robot_names,
)
from mulan.simulation.timeline import RobotMotion, TourConfig
from mulan.simulation.tour import order_views

_ROOM_MARGIN_M = 2.0


@dataclass(frozen=True)
class ImageMissionConfig:
    """Robots that share an existing set of photographs."""

    robots: int = 2
    """Number of robots."""
    split: Literal["azimuth", "random", "alternate"] = "azimuth"
    """Who takes which photograph: contiguous sectors around the scene, drawn by lot, or dealt in turn."""
    metres_per_unit: float = 1.0
    """Size of one unit of the image set's poses."""
    room: Literal["auto", "none"] = "auto"
    """Walls that reflect radio: a box 2 m around everything the robots do, or free space."""
    seed: int = 0
    """Source of all randomness."""
    tour: TourConfig = field(default_factory=TourConfig)
    """Pace."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """Noise."""


def simulate_from_images(images: PosedImageSet, config: ImageMissionConfig) -> Mission:
    """Robots that tour the poses of an image set and record odometry, WiFi and UWB on the way.

    Photographs are the original files, byte for byte, taken exactly at their poses. The world is the image
    set's, z up, scaled to metres; held-out views are the set's test images in the same world.

    Raises:
        InputError: Too few photographs, a photograph that cannot be read, is neither PNG nor JPEG, or has
            other intrinsics than its fellows.
    """
    robot_names(config.robots, "ImageMissionConfig")
    if len(images.train) < config.robots:
        raise InputError(
            images.source,
            "training images",
            f"{len(images.train)} cannot be shared by {config.robots} robots",
            "use fewer robots or more images",
        )
    if not config.metres_per_unit > 0:
        raise InputError(
            "options", "metres_per_unit", f"{config.metres_per_unit} is not positive", "give a length"
        )
    T_world_camera = _poses_m(images.train, config.metres_per_unit)
    rng = np.random.default_rng([config.seed, 3])
    tours = []
    for share in share_views(T_world_camera, config.robots, config.split, rng):
        share = share[order_views(T_world_camera[share])]
        chosen = [images.train[i] for i in share]
        encoding, data = _read_images(chosen)
        tours.append(CameraTour(_common_camera(chosen), T_world_camera[share], encoding, data))

    held_out = None
    if images.test:
        encoding, data = _read_images(images.test)
        photos = tuple(Photo(float(k), encoding, one) for k, one in enumerate(data))
        T_test = _poses_m(images.test, config.metres_per_unit)
        held_out = HeldOutViews(_common_camera(images.test), photos, T_test)

    motions = plan_camera_tours(tours, config.tour)
    room = room_around(motions) if config.room == "auto" else None
    return record_mission(tours, motions, Mirrors(room), config.sensors, held_out, config.seed)


def share_views(
    T_world_camera: Float[NDArray, "n 4 4"],
    robots: int,
    split: Literal["azimuth", "random", "alternate"],
    rng: np.random.Generator,
) -> list[Int[NDArray, "share"]]:
    """Indices of the views each robot takes; shares differ by at most one view.

    Azimuth sectors are about the point all cameras look at, and the first begins behind the widest gap.
    """
    n = len(T_world_camera)
    if split == "random":
        return [np.sort(share) for share in np.array_split(rng.permutation(n), robots)]
    if split == "alternate":
        return [np.arange(first, n, robots) for first in range(robots)]
    position, view = T_world_camera[:, :3, 3], -T_world_camera[:, :3, 2]
    offset = position - point_nearest_to_axes(position, view)
    azimuth_rad = np.arctan2(offset[:, 1], offset[:, 0])
    around = np.argsort(azimuth_rad, kind="stable")
    gap = np.diff(azimuth_rad[around], append=azimuth_rad[around[0]] + 2 * np.pi)
    return np.array_split(np.roll(around, -(int(np.argmax(gap)) + 1)), robots)


def room_around(motions: Sequence[RobotMotion]) -> RoomConfig:
    """A box with two metres of air around everything the robots do."""
    points = np.concatenate([motion.pose(motion.sample_times())[:, :3, 3] for motion in motions])
    low, high = points.min(0) - _ROOM_MARGIN_M, points.max(0) + _ROOM_MARGIN_M
    return RoomConfig(
        (float(low[0]), float(low[1]), float(low[2])), (float(high[0]), float(high[1]), float(high[2]))
    )


def _poses_m(images: Sequence[PosedImage], metres_per_unit: float) -> Float[NDArray, "n 4 4"]:
    T = np.stack([image.T_world_camera for image in images])
    T[:, :3, 3] *= metres_per_unit
    return T


def _common_camera(images: Sequence[PosedImage]) -> PinholeCamera:
    camera = images[0].camera
    for image in images:
        if image.camera != camera:
            raise InputError(
                image.path,
                "intrinsics",
                f"differ from those of {images[0].path.name}, but a robot has one camera",
                "resize the images to one camera or simulate each camera's images apart",
            )
    return camera


def _read_images(images: Sequence[PosedImage]) -> tuple[str, tuple[bytes, ...]]:
    """The files' bytes and their one encoding."""
    files = []
    encodings = []
    for image in images:
        data, encoding = _read_image(image.path)
        files.append(data)
        encodings.append(encoding)
        if encoding != encodings[0]:
            raise InputError(
                image.path,
                "encoding",
                f"{encoding} among {encodings[0]} files",
                "convert the images to one format",
            )
    return encodings[0], tuple(files)


def _read_image(path: Path) -> tuple[bytes, str]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, "image", error.strerror or str(error), "check the image set") from error
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return data, "png"
    if data.startswith(b"\xff\xd8\xff"):
        return data, "jpeg"
    raise InputError(path, "image", "is neither PNG nor JPEG", "convert it")
