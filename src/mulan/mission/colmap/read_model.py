"""A COLMAP sparse model from disk; what a file claims is checked against what it holds."""

import io
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission import ros_poses
from mulan.mission.colmap.camera_models import BY_ID, BY_NAME, LensModel, to_camera
from mulan.mission.colmap.model import ColmapImage, ColmapModel
from mulan.mission.ros_poses import T_OPTICAL_OPENGL

_AGAIN = "write the model again with COLMAP"
_UNDISTORT = "undistort the images with 'colmap image_undistorter'"
_LONGEST_NAME = 4096
_POINT2D_BYTES = 24  # x, y as float64 and the id of a 3-D point


def find_model(folder: Path) -> Path | None:
    """Where below a folder the model lies: the folder itself, ``sparse/0`` or ``sparse``; None if nowhere."""
    for candidate in (folder, folder / "sparse" / "0", folder / "sparse"):
        if any((candidate / f"cameras.{kind}").is_file() for kind in ("bin", "txt")):
            return candidate
    return None


def read_model(folder: Path) -> ColmapModel:
    """Read the cameras and images of a model, binary files first; its points are not needed.

    Raises:
        InputError: A file is missing, cut short or holds something that cannot be used; a lens is no pinhole
            with OpenCV distortion; an image names a camera that is not there, or a file outside its folder.
    """
    if (folder / "cameras.bin").is_file():
        cameras = dict(_binary_cameras(_Bytes(folder / "cameras.bin")))
        images = tuple(_binary_images(_Bytes(folder / "images.bin")))
        path = folder / "images.bin"
    else:
        cameras = dict(_text_cameras(folder / "cameras.txt"))
        images = tuple(_text_images(folder / "images.txt"))
        path = folder / "images.txt"
    if not images:
        raise InputError(path, "images", "there are none", "register photographs with COLMAP first")
    for image in images:
        if image.camera_id not in cameras:
            raise InputError(
                path,
                f"image {image.name}",
                f"names camera {image.camera_id}, which is not in the model",
                _AGAIN,
            )
    names = [image.name for image in images]
    if len(set(names)) < len(names):
        raise InputError(path, "images", "two have one name", _AGAIN)
    return ColmapModel(cameras, images)


class _Bytes:
    """A binary file read field by field; running out of it is one sentence."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.file = io.BytesIO(path.read_bytes())
        except OSError as error:
            raise InputError(path, "file", error.strerror or str(error), "name the model's folder") from error
        self.size = self.file.getbuffer().nbytes

    def take(self, form: str) -> tuple:
        data = self.file.read(struct.calcsize(form))
        if len(data) < struct.calcsize(form):
            raise self.error("file", "ends too early")
        return struct.unpack(form, data)

    def count(self, least_bytes: int, what: str) -> int:
        """How many records follow; no more than the rest of the file could hold."""
        (number,) = self.take("<Q")
        if number * least_bytes > self.size - self.file.tell():
            raise self.error(what, f"claims {number}, more than the file holds")
        return number

    def name(self) -> str:
        at = self.file.tell()
        data = self.file.read(_LONGEST_NAME)
        end = data.find(b"\0")
        if end < 0:
            raise self.error("image name", "does not end")
        self.file.seek(at + end + 1)
        try:
            return data[:end].decode()
        except UnicodeDecodeError:
            raise self.error("image name", "is no UTF-8 text") from None

    def error(self, field: str, problem: str) -> InputError:
        return InputError(self.path, field, problem, _AGAIN)


def _binary_cameras(data: _Bytes) -> Iterator[tuple[int, PinholeCamera]]:
    for _ in range(data.count(24, "cameras")):
        key, number, width, height = data.take("<IiQQ")
        model = BY_ID.get(number)
        if model is None:
            raise data.error(f"camera {key}", f"has the unknown lens model {number}")
        yield key, _camera(data.path, key, model, width, height, data.take(f"<{model.count}d"))


def _text_cameras(path: Path) -> Iterator[tuple[int, PinholeCamera]]:
    for number, line in _lines(path):
        words = line.split()
        if not words:
            continue
        model = BY_NAME.get(words[1]) if len(words) > 1 else None
        if model is None or len(words) != 4 + model.count:
            raise InputError(path, f"line {number}", "is no camera of a known lens model", _AGAIN)
        try:
            key, width, height = (int(words[i]) for i in (0, 2, 3))
            parameters = tuple(map(float, words[4:]))
        except ValueError:
            raise InputError(path, f"line {number}", "holds something that is no number", _AGAIN) from None
        yield key, _camera(path, key, model, width, height, parameters)


def _camera(
    path: Path, key: int, model: LensModel, width: int, height: int, parameters: tuple[float, ...]
) -> PinholeCamera:
    if not all(map(math.isfinite, parameters)):
        raise InputError(path, f"camera {key}", "holds NaN or infinity", _AGAIN)
    try:
        return to_camera(model, width, height, parameters)
    except ValueError as error:
        raise InputError(path, f"camera {key}", str(error), _UNDISTORT) from error


def _binary_images(data: _Bytes) -> Iterator[ColmapImage]:
    for _ in range(data.count(73, "images")):
        _key, *pose, camera_id = data.take("<I7dI")
        name = data.name()
        points = data.count(_POINT2D_BYTES, f"2-D points of {name}")
        data.file.seek(points * _POINT2D_BYTES, io.SEEK_CUR)
        yield _image(data.path, name, camera_id, pose)


def _text_images(path: Path) -> Iterator[ColmapImage]:
    lines = list(_lines(path))
    # every other line holds 2-D points and may be empty; only lines before the first image may be skipped
    while lines and not lines[0][1].split():
        lines.pop(0)
    for number, line in lines[::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        try:
            pose, camera_id, name = [float(word) for word in words[1:8]], int(words[8]), words[9].strip()
        except (ValueError, IndexError):
            raise InputError(
                path, f"line {number}", "is not 'IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME'", _AGAIN
            ) from None
        yield _image(path, name, camera_id, pose)


def _image(path: Path, name: str, camera_id: int, pose: list[float]) -> ColmapImage:
    if not name or Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(path, f"image name '{name}'", "leads out of the image folder", _AGAIN)
    w, x, y, z, *t = pose
    length = math.hypot(x, y, z, w)
    # COLMAP itself normalises; only a length that cannot be one is a fault
    if not abs(length - 1) < 0.1:
        raise InputError(path, f"image {name}", f"has a quaternion of length {length:.4g}", _AGAIN)
    q = np.array([[x, y, z, w]]) / length
    try:
        T_optical_world = ros_poses.to_matrices(np.array([t]), q)[0]
    except ValueError as error:
        raise InputError(path, f"image {name}", str(error).replace(" 0 ", " "), _AGAIN) from error
    return ColmapImage(name, camera_id, se3.inverse(T_optical_world) @ T_OPTICAL_OPENGL)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines that are no comments, with their numbers."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(path, "file", error.strerror or str(error), "name the model's folder") from error
    except UnicodeDecodeError as error:
        raise InputError(path, "file", f"is no text ({error})", _AGAIN) from error
    return ((i, line) for i, line in enumerate(lines, start=1) if not line.startswith("#"))
