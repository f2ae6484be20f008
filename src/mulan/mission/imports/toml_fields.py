"""Fields of a TOML file written by hand, each checked before it is used."""

import difflib
import math
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.geometry.camera import PinholeCamera
from mulan.mission import ros_poses
from mulan.mission.ros_camera import PIXEL_CENTRE

CAMERA_EXAMPLE = "fx = 458.7, fy = 457.3, cx = 367.2, cy = 248.4, width = 752, height = 480"


def load_toml(path: Path) -> "Table":
    """The outermost table of a file.

    Raises:
        InputError: The file is missing or is no TOML.
    """
    try:
        return Table(path, "", tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise InputError(path, "file", error.strerror or str(error), "check the path") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(path, "TOML", str(error), "correct that line") from error


@dataclass(frozen=True)
class Table:
    """One table of a file, and where in it that is.

    Attributes:
        path: The file.
        where: The table's name, for messages.
        values: What it holds.
    """

    path: Path
    where: str
    values: dict[str, Any]

    def error(self, key: str, problem: str, remedy: str) -> InputError:
        """The sentence for something wrong with a key."""
        return InputError(self.path, f"{self.where}.{key}" if self.where else key, problem, remedy)

    def only(self, known: Collection[str]) -> None:
        """Refuse keys nobody reads.

        Raises:
            InputError: There is one; the nearest known key is named.
        """
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(key, known, 1)
                remedy = f"did you mean {near[0]}?" if near else f"known are {', '.join(sorted(known))}"
                raise self.error(key, "is unknown", remedy.rstrip("?"))

    def text(self, key: str) -> str | None:
        """A text, or None where the key is absent.

        Raises:
            InputError: It is something else, or empty.
        """
        value = self.values.get(key)
        if value is not None and (not isinstance(value, str) or not value):
            raise self.error(key, f"is {value!r}", "give a text in quotes")
        return value

    def table(self, key: str) -> "Table | None":
        """A table inside, or None where the key is absent.

        Raises:
            InputError: It is something else.
        """
        value = self.values.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(key, "is no table", f"write [{self.where + '.' if self.where else ''}{key}]")
        return Table(self.path, f"{self.where}.{key}" if self.where else key, value)

    def numbers(self, key: str, count: int | None = None) -> Float[NDArray, "n"] | None:
        """A list of finite numbers (nested lists are flattened), or None where the key is absent.

        Raises:
            InputError: It is something else, or of another length.
        """
        value = self.values.get(key)
        if value is None:
            return None
        try:
            numbers = np.array(value, dtype=float).ravel()
        except (TypeError, ValueError):
            numbers = np.array([np.nan])
        if not np.isfinite(numbers).all() or (count is not None and len(numbers) != count):
            raise self.error(key, f"is {value!r}", f"give {count or 'finite'} numbers")
        return numbers

    def number(self, key: str) -> float | None:
        """One finite number, or None where the key is absent.

        Raises:
            InputError: It is something else.
        """
        value = self.values.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.error(key, f"is {value!r}", "give a finite number")
        return float(value)


def camera_of(table: Table) -> PinholeCamera:
    """A camera from ``width``, ``height``, ``fx``, ``fy``, ``cx``, ``cy``, ``distortion``, ``first_pixel``.

    ``distortion`` is (k1, k2, p1, p2[, k3]); ``first_pixel`` says where the centre of the first pixel lies in
    the calibration: 0 in OpenCV, ROS and Kalibr (the default), 0.5 in COLMAP.

    Raises:
        InputError: Something is missing or cannot be used.
    """
    table.only({"width", "height", "fx", "fy", "cx", "cy", "distortion", "first_pixel"})
    values: dict[str, float] = {}
    for key in ("width", "height", "fx", "fy", "cx", "cy"):
        value = table.number(key)
        if value is None or (value <= 0 and key not in ("cx", "cy")):
            raise table.error(
                key, "is missing or not positive", f"give the calibration, e.g. {CAMERA_EXAMPLE}"
            )
        values[key] = value
    distortion = table.numbers("distortion")
    if distortion is not None and len(distortion) not in (4, 5):
        raise table.error(
            "distortion", f"has {len(distortion)} numbers", "give k1, k2, p1, p2 and perhaps k3"
        )
    first = table.number("first_pixel")
    shift = PIXEL_CENTRE - (0.0 if first is None else first)
    return PinholeCamera(
        round(values["width"]),
        round(values["height"]),
        values["fx"],
        values["fy"],
        values["cx"] + shift,
        values["cy"] + shift,
        *(() if distortion is None else map(float, distortion)),
    )


def transform_of(table: Table) -> Float[NDArray, "4 4"]:
    """A rigid transform from ``translation_m`` and ``quaternion_xyzw``, or from ``matrix`` (4x4 in rows).

    Raises:
        InputError: Something is missing or is no rigid transform.
    """
    table.only({"translation_m", "quaternion_xyzw", "matrix"})
    matrix = table.numbers("matrix", 16)
    if matrix is not None:
        T = matrix.reshape(4, 4)
        R = T[:3, :3]
        if (
            np.abs(R.T @ R - np.eye(3)).max() > 1e-3
            or np.linalg.det(R) < 0
            or np.abs(T[3] - [0, 0, 0, 1]).any()
        ):
            raise table.error("matrix", "is no rigid transform", "give 16 numbers in rows, the last 0 0 0 1")
        U, _, Vt = np.linalg.svd(R)
        return se3.from_parts(U @ Vt, T[:3, 3])
    translation_m, quaternion = table.numbers("translation_m", 3), table.numbers("quaternion_xyzw", 4)
    t = np.zeros(3) if translation_m is None else translation_m
    q = np.array([0.0, 0.0, 0.0, 1.0]) if quaternion is None else quaternion
    try:
        return ros_poses.to_matrices(t[None], q[None])[0]
    except ValueError as error:
        raise table.error("quaternion_xyzw", str(error), "give x, y, z, w of unit length") from error
