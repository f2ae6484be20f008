"""What photographs say about where they were taken, as refinement hands it to localization."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from mulan.errors import InputError
from mulan.mission.run_folder import write_atomically

_REMEDY = "make it again with 'mulan train --refine-poses'"


@dataclass(frozen=True)
class PhotographInformation:
    """A quadratic about refined camera poses, localization's own knowledge not in it.

    Attributes:
        robots: Who took each photograph.
        time_s: When, on that robot's clock.
        T_world_camera: Refined poses (OpenGL axes).
        information: Of right perturbations of all poses together (rotation rad, translation m). What moves
            all cameras alike has none, unless some photographs' poses were exact.
    """

    robots: tuple[str, ...]
    time_s: Float[NDArray, "n"]
    T_world_camera: Float[NDArray, "n 4 4"]
    information: Float[NDArray, "m m"]


def write_photograph_information(found: PhotographInformation, path: Path) -> None:
    """Write it.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    tensors = {
        name: np.ascontiguousarray(getattr(found, name), dtype=np.float64)
        for name in ("time_s", "T_world_camera", "information")
    }
    names = {"robots": "\n".join(found.robots)}
    write_atomically(path, lambda temporary: save_file(tensors, temporary, metadata=names))


def read_photograph_information(path: Path) -> PhotographInformation:
    """Read what :func:`write_photograph_information` wrote.

    Raises:
        InputError: The file is missing, damaged or holds something else.
    """
    if not path.is_file():
        raise InputError(path, "file", "does not exist", _REMEDY)
    try:
        with safe_open(path, framework="numpy") as file:
            robots = tuple((file.metadata() or {})["robots"].split("\n"))
            time_s, T, information = (
                file.get_tensor(name).astype(np.float64)
                for name in ("time_s", "T_world_camera", "information")
            )
    except (SafetensorError, OSError, KeyError) as error:
        raise InputError(path, "tensors", f"cannot be read ({error})", _REMEDY) from error
    n = len(robots)
    shapes = (time_s.shape, T.shape, information.shape)
    if shapes != ((n,), (n, 4, 4), (6 * n, 6 * n)):
        raise InputError(path, "tensors", f"have the shapes {shapes} for {n} photographs", _REMEDY)
    if not all(np.isfinite(array).all() for array in (time_s, T, information)):
        raise InputError(path, "tensors", "hold NaN or infinity", _REMEDY)
    return PhotographInformation(robots, time_s, T, information)
