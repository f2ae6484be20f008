"""Image sets of the nerfstudio and instant-ngp kind: one ``transforms.json``."""

import math
import os
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission import json_fields, pixels, run_folder
from mulan.mission.blender import image_file
from mulan.mission.posed_images import PosedImage, PosedImageSet

# names of fields, ours to theirs
_INTRINSICS = {"width": "w", "height": "h", "fx": "fl_x", "fy": "fl_y", "cx": "cx", "cy": "cy"}
_DISTORTION = ("k1", "k2", "p1", "p2", "k3")
# COLMAP's models that are OPENCV with some coefficients zero
_CAMERA_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_JOINT = "joint_pose_covariance"
COVARIANCE_CONVENTION = (
    "6x6 over (rotation rad, translation m), right perturbation: transform_matrix @ exp(xi), "
    "OpenGL camera axes"
)


def read_transforms(path: Path) -> PosedImageSet:
    """Read a ``transforms.json``.

    Intrinsics may stand once or in each frame. ``robot_id``, ``timestamp`` and ``pose_covariance`` are read
    where frames have them, and the file that ``joint_pose_covariance`` names. Frames named in
    ``test_filenames`` are held out; where ``train_filenames`` is given too, frames in neither list
    (validation) are left out. Without the lists all frames are for training.

    Raises:
        InputError: A file, image, pose or focal length is missing or cannot be used, or the lens is no
            pinhole.
    """
    record = json_fields.load_object(path)
    frames = json_fields.frames(record, path)
    test_names = _names(record, "test_filenames", frames, path)
    train_names = _names(record, "train_filenames", frames, path)
    train, test = [], []
    for frame in frames:
        name = frame["file_path"]
        if test_names is not None and name in test_names:
            test.append(_read_frame(record, frame, path))
        elif train_names is None or name in train_names:
            train.append(_read_frame(record, frame, path))
    return PosedImageSet(tuple(train), tuple(test), path, _read_joint(record, train, path))


def write_transforms(images: PosedImageSet, path: Path, points_file: Path | None = None) -> None:
    """Write an image set as ``transforms.json``; image paths are relative to it.

    Intrinsics stand once where all cameras agree, else in each frame. Test frames are named as validation
    frames too, since nerfstudio refuses a file that names some splits but not all; without test frames
    none is named. A joint covariance goes to a file beside it, ``<name>_joint_covariance.safetensors``.

    Args:
        images: The set.
        path: Target.
        points_file: Point cloud in the same frame, for trainers that begin from points.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    everything = (*images.train, *images.test)
    cameras = [image.camera for image in everything]
    shared = len(set(cameras)) == 1
    record: dict[str, Any] = {"camera_model": "OPENCV"}
    record |= _camera_fields(cameras[0]) if shared else {}
    record["pose_covariance_convention"] = COVARIANCE_CONVENTION
    if points_file is not None:
        record["ply_file_path"] = _relative(points_file, path)
    if images.test:
        splits = {
            "train_filenames": images.train,
            "val_filenames": images.test,
            "test_filenames": images.test,
        }
        record |= {key: [_relative(image.path, path) for image in split] for key, split in splits.items()}
    record["frames"] = [_write_frame(image, path, shared) for image in everything]
    if images.joint_pose_covariance is not None:
        beside = path.with_name(f"{path.stem}_joint_covariance.safetensors")
        tensors = {_JOINT: np.ascontiguousarray(images.joint_pose_covariance, dtype=np.float64)}
        run_folder.write_atomically(beside, lambda temporary: save_file(tensors, temporary))
        record[_JOINT] = beside.name
    run_folder.write_json(path, record)


def _names(record: dict[str, Any], key: str, frames: list[dict[str, Any]], path: Path) -> set[str] | None:
    names = record.get(key)
    if names is None:
        return None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise InputError(path, key, "is not a list of file names", "list file_path values of frames")
    if unknown := sorted(set(names) - {frame["file_path"] for frame in frames}):
        raise InputError(
            path, key, f"names {unknown[0]}, which is no frame", "list file_path values of frames"
        )
    return set(names)


def _read_frame(record: dict[str, Any], frame: dict[str, Any], path: Path) -> PosedImage:
    name = frame["file_path"]
    file = image_file(path.parent, name)
    robot_id = frame.get("robot_id")
    if not isinstance(robot_id, str | None):
        raise InputError(path, f"robot_id of {name}", f"is {robot_id!r}", "give a text")
    return PosedImage(
        path=file,
        camera=_read_camera(record | frame, file, path),
        T_world_camera=json_fields.pose(frame, path),
        pose_covariance=json_fields.pose_covariance(frame, path),
        robot_id=robot_id,
        timestamp_s=json_fields.number(frame, "timestamp", path, f"{name}: "),
    )


def _read_joint(record: dict[str, Any], train: list[PosedImage], path: Path) -> NDArray[np.float64] | None:
    """Covariance of all uncertain training images together, from the file beside."""
    name = record.get(_JOINT)
    if name is None:
        return None
    if not isinstance(name, str) or Path(name).name != name:
        raise InputError(path, _JOINT, f"is {name!r}, no name of a file beside it", "remove the field")
    try:
        joint = load_file(path.with_name(name))[_JOINT].astype(np.float64)
    except (OSError, SafetensorError, KeyError) as error:
        remedy = f"copy it along, or remove {_JOINT} from {path.name}"
        raise InputError(path.with_name(name), "file", f"cannot be read ({error})", remedy) from error
    size = 6 * sum(image.pose_covariance is not None for image in train)
    if joint.shape != (size, size) or not np.isfinite(joint).all():
        problem = f"is {' x '.join(map(str, joint.shape))}, or not finite, where {size} x {size} belongs"
        remedy = f"write the set again, or remove {_JOINT} from {path.name}"
        raise InputError(path.with_name(name), _JOINT, problem, remedy)
    return joint


def _read_camera(fields: dict[str, Any], file: Path, path: Path) -> PinholeCamera:
    """Camera of one frame; ``fields`` are the frame's over the file's."""
    where = f"{fields['file_path']}: "

    def get(key: str, default: float = 0.0) -> float:
        value = json_fields.number(fields, key, path, where)
        return default if value is None else value

    model = fields.get("camera_model", "OPENCV")
    if model not in _CAMERA_MODELS or fields.get("is_fisheye") or get("k4") != 0:
        lens = model if model not in _CAMERA_MODELS else "fisheye or k4"
        raise InputError(
            path,
            f"{where}camera_model",
            f"'{lens}' is not supported",
            "undistort the images to PINHOLE or OPENCV",
        )
    width, height = pixels.image_size(file, str(file))
    stated = (get("w", float(width)), get("h", float(height)))
    if stated != (width, height):
        raise InputError(
            path,
            f"{where}w, h",
            f"are {stated[0]:g}x{stated[1]:g} but the image has {width}x{height} pixels",
            "scale w, h, fl_x, fl_y, cx and cy to the image",
        )
    fx = get("fl_x") or _focal(get("camera_angle_x"), width)
    fy = get("fl_y") or _focal(get("camera_angle_y"), height) or fx
    if fx <= 0 or fy <= 0:
        raise InputError(path, f"{where}fl_x", "no focal length is given", "add fl_x or camera_angle_x")
    camera = PinholeCamera(width, height, fx, fy, get("cx", width / 2), get("cy", height / 2))
    return replace(camera, **{name: get(name) for name in _DISTORTION})


def _focal(angle_rad: float, size: int) -> float:
    """Focal length in pixels of a view angle; 0 where there is none."""
    return 0.5 * size / math.tan(0.5 * angle_rad) if 0 < angle_rad < math.pi else 0.0


def _camera_fields(camera: PinholeCamera) -> dict[str, Any]:
    fields = asdict(camera)
    return {theirs: fields[ours] for ours, theirs in _INTRINSICS.items()} | {
        k: fields[k] for k in _DISTORTION
    }


def _relative(file: Path, path: Path) -> str:
    return Path(os.path.relpath(file.resolve(), path.parent.resolve())).as_posix()


def _write_frame(image: PosedImage, path: Path, shared: bool) -> dict[str, Any]:
    frame: dict[str, Any] = {
        "file_path": _relative(image.path, path),
        "transform_matrix": image.T_world_camera.tolist(),
    }
    if not shared:
        frame |= _camera_fields(image.camera)
    if image.robot_id is not None:
        frame["robot_id"] = image.robot_id
    if image.timestamp_s is not None:
        frame["timestamp"] = image.timestamp_s
    if image.pose_covariance is not None:
        frame["pose_covariance"] = image.pose_covariance.tolist()
    return frame
