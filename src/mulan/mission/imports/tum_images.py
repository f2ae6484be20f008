"""A trajectory and a folder of photographs as a posed image set, poses interpolated to the photographs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission import pixels
from mulan.mission.imports.image_times import image_times
from mulan.mission.imports.toml_fields import Table, camera_of, load_toml, transform_of
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.ros_poses import T_OPTICAL_OPENGL
from mulan.mission.tum import read_tum


@dataclass(frozen=True)
class InterpolationConfig:
    """How far from recorded poses a photograph may be."""

    longest_gap_s: float = 0.5
    """Between the poses on both sides of a photograph."""
    skip_outside: bool = False
    """Leave out photographs before the first pose, after the last, or in a longer gap; else refused."""


def read_tum_images(
    trajectory: Path, folder: Path, calibration: Path, times: Path | None, config: InterpolationConfig
) -> PosedImageSet:
    """Pose photographs along a trajectory; poses are never extrapolated.

    Args:
        trajectory: TUM text, of the camera's optical frame unless the calibration has a mount.
        folder: Photographs; see :func:`image_times`.
        calibration: TOML with a table ``[camera]`` and, where the trajectory is of something else,
            ``[camera_mount]``: the camera (optical axes) on it.
        times: List of times and files, if not found by itself.
        config: What is close enough.

    Raises:
        InputError: A file is missing or cannot be used, a photograph is not of the calibrated size, or lies
            outside the trajectory's time or in a gap of it.
    """
    track = read_tum(trajectory)
    record = load_toml(calibration)
    record.only({"camera", "camera_mount"})
    camera, T_body_optical = _camera(record)
    found = image_times(folder, times)
    time_s = np.array([time for time, _ in found])
    after = np.clip(np.searchsorted(track.time_s, time_s), 1, max(len(track.time_s) - 1, 1))
    exact = np.isin(time_s, track.time_s)
    inside = (time_s >= track.time_s[0]) & (time_s <= track.time_s[-1])
    gap_s = np.zeros(len(time_s)) if len(track.time_s) < 2 else track.time_s[after] - track.time_s[after - 1]
    usable = exact | (inside & (gap_s <= config.longest_gap_s))
    if not usable.all() and not (config.skip_outside and usable.any()):
        first = int(np.argmin(usable))
        raise InputError(
            found[first][1],
            f"time {time_s[first]:.6f} s",
            f"lies in a gap of {gap_s[first]:.2f} s between poses"
            if inside[first]
            else f"lies outside the trajectory ({track.time_s[0]:.6f} to {track.time_s[-1]:.6f} s)",
            f"{len(time_s) - int(usable.sum())} of {len(time_s)} photographs are so; leave them out with"
            " --poses.skip-outside, or check that both use one clock",
        )
    T_world_camera = (
        se3.interpolate(track.time_s, track.T_world_body, time_s[usable]) @ T_body_optical @ T_OPTICAL_OPENGL
    )
    kept = [each for each, good in zip(found, usable, strict=True) if good]
    images = []
    for (time, path), T in zip(kept, T_world_camera, strict=True):
        width, height = pixels.image_size(path, str(path))
        if (width, height) != (camera.width, camera.height):
            raise InputError(
                path,
                "image",
                f"has {width}x{height} pixels, {calibration.name} says {camera.width}x{camera.height}",
                "scale width, height, fx, fy, cx and cy to the photographs",
            )
        images.append(PosedImage(path, camera, T, timestamp_s=time))
    return PosedImageSet(tuple(images), (), trajectory)


def _camera(record: Table) -> tuple[PinholeCamera, np.ndarray]:
    table, mount = record.table("camera"), record.table("camera_mount")
    if table is None:
        raise record.error("camera", "is missing", "add [camera] with width, height, fx, fy, cx, cy")
    return camera_of(table), np.eye(4) if mount is None else transform_of(mount)
