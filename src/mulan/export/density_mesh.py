"""The surface of a field as triangles: marching cubes over its density, slab by slab."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mulan.errors import InputError
from mulan.export.crop import Box
from mulan.export.extras import extra_module
from mulan.radiance.engine import RadianceEngine

_POINTS_AT_ONCE = 65536
_SLAB_CELLS = 16


@dataclass(frozen=True)
class TriangleMesh:
    """Triangles whose corners run counter-clockwise seen from outside.

    Attributes:
        position_m: Vertices in the world.
        faces: Indices of each triangle's corners.
    """

    position_m: Float[NDArray, "v 3"]
    faces: Int[NDArray, "f 3"]

    def normals(self) -> Float[NDArray, "v 3"]:
        """Outward unit normal of each vertex, its triangles weighted by area."""
        a, b, c = (self.position_m[self.faces[:, k]] for k in range(3))
        across = np.cross(b - a, c - a)
        total = np.stack(
            [
                np.bincount(self.faces.ravel(), np.repeat(across[:, k], 3), len(self.position_m))
                for k in range(3)
            ],
            axis=1,
        )
        return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12)


def density_mesh(
    engine: RadianceEngine,
    box: Box,
    resolution: int,
    level_per_m: float,
    progress: Callable[[float, float, str], None],
) -> TriangleMesh:
    """Triangles where the density crosses a level, closed where the box cuts through matter.

    Only one slab of the lattice is in memory at a time.

    Args:
        engine: The field.
        box: The part of the world to look at.
        resolution: Cells along the box's longest side.
        level_per_m: Density of the surface [1/m].
        progress: Called with what is done.

    Raises:
        InputError: scikit-image is missing, the resolution is out of bounds, or there is no surface.
    """
    measure = extra_module("skimage.measure", "scikit-image", "--to mesh")
    if not 2 <= resolution <= 2048:
        raise InputError("--mesh", "resolution", f"is {resolution}", "give 2 to 2048")
    size_m = box.high_m - box.low_m
    voxel_m = float(size_m.max()) / resolution
    cells = np.maximum(np.ceil(size_m / voxel_m - 1e-9).astype(int), 1)
    start_m = (box.low_m + box.high_m - cells * voxel_m) / 2
    vertices, faces, count = [], [], 0
    for first, density in _slabs(engine, start_m, voxel_m, cells, progress):
        # the logarithm crosses the level where the density does, and more evenly between the lattice's points
        values = np.log1p(density / np.float32(level_per_m))
        level = float(np.log(2))
        if not values.min() < level < values.max():
            continue
        corners, triangles, _, _ = measure.marching_cubes(values, level, gradient_direction="ascent")
        corners += [first, -1, -1]  # one empty layer lies before the first in y and z too
        vertices.append(corners)
        faces.append(triangles.astype(np.int64) + count)
        count += len(corners)
    if not vertices:
        raise InputError(
            "--mesh",
            "density",
            f"nowhere in the box reaches {level_per_m:.3g} per metre",
            "lower the level, widen --crop or train longer",
        )
    # neighbouring slabs compute their common corners from the same numbers, so these are equal to the bit
    lattice, index = np.unique(np.concatenate(vertices), axis=0, return_inverse=True)
    triangles = index.reshape(-1)[np.concatenate(faces)]
    proper = (triangles != np.roll(triangles, 1, axis=1)).all(1)
    return TriangleMesh(start_m + lattice.astype(float) * voxel_m, triangles[proper])


def in_large_pieces(mesh: TriangleMesh, least_share: float) -> Bool[NDArray, "f"]:
    """Which triangles belong to connected pieces with at least a share of the largest one's triangles."""
    ends = mesh.faces[:, [0, 1]].ravel(), mesh.faces[:, [1, 2]].ravel()
    size = len(mesh.position_m)
    links = coo_matrix((np.ones(len(ends[0]), np.int8), ends), shape=(size, size))
    _, piece = connected_components(links, directed=False)
    piece_of_face = piece[mesh.faces[:, 0]]
    triangles = np.bincount(piece_of_face)
    return triangles[piece_of_face] >= least_share * triangles.max(initial=0)


def kept_faces(mesh: TriangleMesh, keep: Bool[NDArray, "f"]) -> tuple[TriangleMesh, Int[NDArray, "w"]]:
    """The mesh of some triangles, and the vertices of the old mesh that it still has."""
    used, faces = np.unique(mesh.faces[keep], return_inverse=True)
    return TriangleMesh(mesh.position_m[used], faces.reshape(-1, 3)), used


def _slabs(
    engine: RadianceEngine,
    start_m: Float[NDArray, "3"],
    voxel_m: float,
    cells: Int[NDArray, "3"],
    progress: Callable[[float, float, str], None],
) -> Iterator[tuple[int, Float32[NDArray, "x y z"]]]:
    """Densities at the lattice's points, and the first layer's number; nothing is outside the lattice.

    One empty layer is added on every side, so that surfaces close there.
    """
    y, z = np.meshgrid(np.arange(cells[1] + 1), np.arange(cells[2] + 1), indexing="ij")
    empty = np.zeros((cells[1] + 3, cells[2] + 3), np.float32)

    def layer(x: int) -> Float32[NDArray, "y z"]:
        if not 0 <= x <= cells[0]:
            return empty
        lattice = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)
        points = torch.from_numpy((start_m + voxel_m * lattice).astype(np.float32))
        density = torch.cat([engine.density(part) for part in points.split(_POINTS_AT_ONCE)])
        return np.pad(density.cpu().numpy().reshape(y.shape), 1)

    last = layer(-1)
    for first in range(-1, int(cells[0]) + 1, _SLAB_CELLS):
        progress(first + 1, int(cells[0]) + 2, "")
        end = min(first + _SLAB_CELLS, int(cells[0]) + 1)
        slab = np.stack([last, *(layer(x) for x in range(first + 1, end + 1))])
        last = slab[-1]
        yield first, slab
    progress(1, 1, "")
