"""A COLMAP sparse model on disk: ``cameras``, ``images`` and ``points3D``, binary or text."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3, so3
from mulan.mission.colmap.camera_models import to_parameters
from mulan.mission.colmap.model import ColmapImage, ColmapModel
from mulan.mission.coloured_points import ColouredPoints
from mulan.mission.ros_poses import T_OPTICAL_OPENGL
from mulan.mission.run_folder import write_atomically

_POINT = np.dtype(
    [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track_length", "<u8")]
)
_NO_ERROR = -1.0  # COLMAP's own word for a reprojection error that was never computed


def write_model(
    model: ColmapModel, points: ColouredPoints | None, folder: Path, as_text: bool = False
) -> None:
    """Write the three files of a sparse model; each appears whole or not at all.

    Args:
        model: Cameras and images.
        points: Points without tracks, for tools that begin from them; None writes an empty file.
        folder: Usually ``sparse/0``.
        as_text: ``.txt`` instead of ``.bin``.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    writers: dict[str, Callable[[BinaryIO], None]] = {
        "cameras": lambda file: _cameras(model, file, as_text),
        "images": lambda file: _images(model, file, as_text),
        "points3D": lambda file: _points(points, file, as_text),
    }
    kept, removed = ("txt", "bin") if as_text else ("bin", "txt")
    for name, write in writers.items():
        write_atomically(folder / f"{name}.{kept}", lambda path, write=write: _into(path, write))
    for name in writers:
        # COLMAP takes whichever kind it finds first
        (folder / f"{name}.{removed}").unlink(missing_ok=True)


def _into(path: Path, write: Callable[[BinaryIO], None]) -> None:
    with path.open("wb") as file:
        write(file)


def _cameras(model: ColmapModel, file: BinaryIO, as_text: bool) -> None:
    if as_text:
        file.write(b"# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n")
    else:
        file.write(struct.pack("<Q", len(model.cameras)))
    for key, camera in model.cameras.items():
        lens, parameters = to_parameters(camera)
        if as_text:
            numbers = " ".join(map(repr, parameters))
            file.write(f"{key} {lens.name} {camera.width} {camera.height} {numbers}\n".encode())
        else:
            file.write(struct.pack("<IiQQ", key, lens.id, camera.width, camera.height))
            file.write(struct.pack(f"<{lens.count}d", *parameters))


def _images(model: ColmapModel, file: BinaryIO, as_text: bool) -> None:
    if as_text:
        file.write(b"# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then a line of 2-D points\n")
    else:
        file.write(struct.pack("<Q", len(model.images)))
    for key, image in enumerate(model.images, start=1):
        pose = camera_from_world(image)
        if as_text:
            numbers = " ".join(map(repr, pose))
            file.write(f"{key} {numbers} {image.camera_id} {image.name}\n\n".encode())
        else:
            file.write(struct.pack("<I7dI", key, *pose, image.camera_id))
            file.write(image.name.encode() + b"\0" + struct.pack("<Q", 0))


def camera_from_world(image: ColmapImage) -> tuple[float, ...]:
    """COLMAP's pose of an image: quaternion (w, x, y, z) and translation of world to optical axes."""
    T = se3.inverse(image.T_world_camera @ T_OPTICAL_OPENGL)
    x, y, z, w = (float(c) for c in so3.to_quaternion(T[:3, :3]))
    return (w, x, y, z, *(float(c) for c in T[:3, 3]))


def _points(points: ColouredPoints | None, file: BinaryIO, as_text: bool) -> None:
    position_m: Float[NDArray, "n 3"] = np.zeros((0, 3)) if points is None else points.position_m
    if as_text:
        file.write(b"# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n")
        for key, xyz in enumerate(position_m, start=1):
            assert points is not None
            rgb = " ".join(map(str, points.colour[key - 1].tolist()))
            file.write(f"{key} {' '.join(map(repr, xyz.tolist()))} {rgb} {_NO_ERROR}\n".encode())
        return
    table = np.zeros(len(position_m), _POINT)
    if points is not None:
        table["id"] = np.arange(1, len(table) + 1)
        table["xyz"], table["rgb"], table["error"] = position_m, points.colour, _NO_ERROR
    file.write(struct.pack("<Q", len(table)) + table.tobytes())
