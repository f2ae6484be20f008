"""Trajectories as TUM text: ``t x y z qx qy qz qw``, seconds and metres, ``#`` comments."""

import gzip
import math
from pathlib import Path

import numpy as np

from mulan.errors import InputError
from mulan.geometry import so3
from mulan.mission import ros_poses
from mulan.mission.run_folder import write_atomically
from mulan.mission.types import PoseTrack

_REMEDY = "write 't x y z qx qy qz qw' on each line"


def write_tum(track: PoseTrack, path: Path) -> None:
    """Write a trajectory (nanosecond stamps, twelve digits a number).

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    quaternions = so3.to_quaternion(track.T_world_body[:, :3, :3])
    lines = [
        f"{time_s:.9f} " + " ".join(f"{value:.12g}" for value in (*T[:3, 3], *q))
        for time_s, T, q in zip(track.time_s, track.T_world_body, quaternions, strict=True)
    ]
    text = "\n".join(["# t x y z qx qy qz qw", *lines]) + "\n"
    write_atomically(path, lambda temporary: temporary.write_text(text))


def read_tum(path: Path) -> PoseTrack:
    """Read a trajectory; ``.gz`` files are unpacked, and of lines with one time the first counts.

    Raises:
        InputError: The file is missing or not text, a line has not eight finite numbers, a quaternion is
            not of unit length, time goes backwards, or there is no pose at all.
    """
    try:
        data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
        lines = data.decode().splitlines()
    except FileNotFoundError:
        raise InputError(path, "file", "does not exist", "check the path to the trajectory") from None
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"cannot be read as text ({error})", _REMEDY) from error
    numbered = [(i, line.split("#")[0].split()) for i, line in enumerate(lines, start=1)]
    numbered = [(i, words) for i, words in numbered if words]
    if not numbered:
        raise InputError(path, "poses", "there are none", _REMEDY)
    rows = []
    for number, words in numbered:
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise InputError(path, f"line {number}", "holds something that is no number", _REMEDY) from None
        if len(row) != 8 or not all(map(math.isfinite, row)):
            raise InputError(
                path, f"line {number}", f"has not eight finite numbers but '{' '.join(words)[:60]}'", _REMEDY
            )
        rows.append(row)
    table = np.array(rows)
    line_of = [i for i, _ in numbered]
    unit = np.abs(np.linalg.norm(table[:, 4:], axis=1) - 1) <= ros_poses.UNIT_TOLERANCE
    if not unit.all():
        line = line_of[int(np.argmin(unit))]
        raise InputError(path, f"line {line}", "the quaternion is not of unit length", _REMEDY)
    step_s = np.diff(table[:, 0], prepend=-np.inf)
    if (step_s < 0).any():
        line = line_of[int(np.argmax(step_s < 0))]
        raise InputError(path, f"line {line}", "the time goes backwards", "sort the lines by time")
    table = table[step_s > 0]
    return PoseTrack(table[:, 0].copy(), ros_poses.to_matrices(table[:, 1:4], table[:, 4:]))
