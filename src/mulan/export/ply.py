"""Binary PLY files of points and meshes (Turk 1994, format binary_little_endian 1.0)."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy.typing import NDArray

from mulan.mission.coloured_points import ColouredPoints
from mulan.mission.run_folder import write_atomically

_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def write_points(points: ColouredPoints, path: Path) -> None:
    """Write positions [m], colours, and ``variance`` as a further property.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    table = _vertices(points.position_m, points.colour, {"variance": points.variance})
    _write(path, table, None)


def write_mesh(
    position_m: Float[NDArray, "v 3"], colour: UInt8[NDArray, "v 3"], faces: Int[NDArray, "f 3"], path: Path
) -> None:
    """Write a triangle mesh with a colour at each corner.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    table = np.zeros(len(faces), _FACE)
    table["count"], table["corners"] = 3, faces
    _write(path, _vertices(position_m, colour, {}), table)


def _vertices(position_m: NDArray, colour: NDArray, further: dict[str, NDArray]) -> NDArray:
    columns = [(name, "<f4") for name in "xyz"]
    columns += [(name, "u1") for name in ("red", "green", "blue")] + [(name, "<f4") for name in further]
    table = np.zeros(len(position_m), np.dtype(columns))
    for axis, name in enumerate("xyz"):
        table[name] = position_m[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        table[name] = colour[:, channel]
    for name, values in further.items():
        table[name] = values
    return table


def _write(path: Path, vertices: NDArray, faces: NDArray | None) -> None:
    fields = vertices.dtype.fields
    assert fields is not None
    lines = ["ply", "format binary_little_endian 1.0", "comment metres", f"element vertex {len(vertices)}"]
    for name, (kind, *_) in fields.items():
        lines.append(f"property {'uchar' if kind == np.uint8 else 'float'} {name}")
    if faces is not None:
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    header = "\n".join([*lines, "end_header", ""]).encode()

    def write(temporary: Path) -> None:
        with temporary.open("wb") as file:
            file.write(header)
            vertices.tofile(file)
            if faces is not None:
                faces.tofile(file)

    write_atomically(path, write)
