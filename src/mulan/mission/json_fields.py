"""Fields of a JSON file written by others, each checked before it is used."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.mission import ros_poses

ROTATION_TOLERANCE = 1e-3  # largest entry of RᵀR - I that rounding may explain


def load_object(path: Path) -> dict[str, Any]:
    """The object a JSON file holds.

    Raises:
        InputError: The file is missing, is not JSON, or holds something else than an object.
    """
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(path, "file", "does not exist", "check the path to the image set") from None
    except OSError as error:
        raise InputError(path, "file", error.strerror or str(error), "check that you may read it") from error
    except (ValueError, RecursionError) as error:
        raise InputError(path, "JSON", f"cannot be read ({error})", "write the file again") from error
    if not isinstance(value, dict):
        raise InputError(path, "JSON", "is not an object", "write a file with 'frames' and intrinsics")
    return value


def frames(record: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    """The list of frames.

    Raises:
        InputError: There is none, or a frame names no file.
    """
    found = record.get("frames")
    if not isinstance(found, list) or not found:
        raise InputError(path, "frames", "there are none", "list at least one photograph")
    for index, frame in enumerate(found):
        if (
            not isinstance(frame, dict)
            or not isinstance(frame.get("file_path"), str)
            or not frame["file_path"]
        ):
            raise InputError(path, f"frames[{index}].file_path", "is missing", "name the photograph's file")
    return found


def number(record: dict[str, Any], key: str, path: Path, where: str = "") -> float | None:
    """A finite number, or None where the key is absent or null.

    Raises:
        InputError: It is no finite number.
    """
    value = record.get(key)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(path, f"{where}{key}", f"is {value!r}", "give a finite number")
    return float(value)


def pose(frame: dict[str, Any], path: Path) -> Float[NDArray, "4 4"]:
    """``transform_matrix`` (3x4 or 4x4), its rotation made exact.

    Raises:
        InputError: It is missing, not finite, or no rotation within ROTATION_TOLERANCE.
    """
    field = f"transform_matrix of {frame['file_path']}"
    matrix = _array(frame.get("transform_matrix"))
    if matrix is None or matrix.shape not in ((4, 4), (3, 4)):
        raise InputError(path, field, "is not a 4x4 matrix of numbers", "give the camera-to-world matrix")
    if not np.isfinite(matrix).all():
        raise InputError(path, field, "holds NaN or infinity", "remove the frame or pose it again")
    R = matrix[:3, :3]
    scaled = np.abs(R.T @ R - np.eye(3)).max() > ROTATION_TOLERANCE
    if scaled or np.linalg.det(R) < 0 or not np.allclose(matrix[3:], [0, 0, 0, 1], atol=1e-6):
        raise InputError(path, field, "is no rigid transform", "remove scale, shear or mirroring from it")
    U, _, Vt = np.linalg.svd(R)
    return se3.from_parts(U @ Vt, matrix[:3, 3])


def pose_covariance(frame: dict[str, Any], path: Path) -> Float[NDArray, "6 6"] | None:
    """``pose_covariance``, or None where it is absent or null.

    Raises:
        InputError: It is no finite, symmetric, positive semi-definite 6x6 matrix.
    """
    value = frame.get("pose_covariance")
    if value is None:
        return None
    matrix = _array(value)
    remedy = "give 36 numbers over (rotation rad, translation m), or leave it out for an exact pose"
    field = f"pose_covariance of {frame['file_path']}"
    if matrix is None or matrix.shape != (6, 6):
        raise InputError(path, field, "is not a 6x6 matrix of numbers", remedy)
    try:
        return ros_poses.check_covariance(matrix[None])[0]
    except ValueError as error:
        raise InputError(path, field, str(error), remedy) from error


def _array(value: Any) -> NDArray | None:
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None
