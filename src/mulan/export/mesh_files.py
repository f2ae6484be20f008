"""A field's surface as a coloured mesh in PLY and GLB."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.export import ply
from mulan.export.crop import Box
from mulan.export.density_mesh import TriangleMesh, density_mesh, in_large_pieces, kept_faces
from mulan.export.extras import extra_module
from mulan.export.settled_mesh import settled
from mulan.export.vertex_views import vertex_views
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import write_atomically
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.space import SceneSpace

_FARTHEST_VOXELS = 3.0  # that a vertex is moved to where the photographs see the surface
LEVEL_PER_RADIUS = 10.0  # density of the surface in units of 1 / scene radius; see docs/export.md
# glTF has y up; the vertices stay in the run's world, a node turns them
_T_GLTF_WORLD = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


@dataclass(frozen=True)
class MeshConfig:
    """Triangles by marching cubes, coloured at the vertices."""

    resolution: int = 256
    """Cells along the longest side of the box."""
    level_per_m: float | None = None
    """Density of the surface [1/m]; 10 a scene radius if not given."""
    only_seen: bool = True
    """Leave out what no photograph looked at: insides, undersides, the rim of the box."""
    least_share: float = 0.01
    """Pieces with less than this share of the largest one's triangles are left out."""


@dataclass(frozen=True)
class ExportedMesh:
    """What was written.

    Attributes:
        files: PLY and GLB.
        triangles: How many.
        size_m: Sides of the box they fill.
    """

    files: tuple[Path, ...]
    triangles: int
    size_m: Float[NDArray, "3"]


def export_mesh(
    engine: RadianceEngine,
    space: SceneSpace,
    images: PosedImageSet,
    box: Box,
    config: MeshConfig,
    folder: Path,
    progress: Callable[[float, float, str], None],
) -> ExportedMesh:
    """Write ``mesh.ply`` and ``mesh.glb``, in metres, in the run's world.

    The GLB's one node turns z up into glTF's y up.

    Args:
        engine: The field.
        space: Where it lives.
        images: Photographs, for colours and for what was seen.
        box: The part of the world to look at.
        config: How.
        folder: Target.
        progress: Called with what is done.

    Raises:
        InputError: A library is missing, there is no surface, or the folder cannot be written.
    """
    trimesh = extra_module("trimesh", "trimesh", "--to mesh")
    level = LEVEL_PER_RADIUS / space.radius_m if config.level_per_m is None else config.level_per_m
    if level <= 0 or not np.isfinite(level):
        raise InputError("--mesh", "level_per_m", f"is {level}", "give a density above zero")
    mesh = density_mesh(engine, box, config.resolution, level, progress)
    voxel_m = float((box.high_m - box.low_m).max()) / config.resolution
    views = vertex_views(engine, mesh, voxel_m, images.train, progress)
    colour, gap_m = views.colour, views.gap_m
    if config.only_seen:
        # a triangle with one seen corner stays: the rim of what was seen is ragged enough
        mesh, used = kept_faces(mesh, np.any(views.seen[mesh.faces], axis=1))
        colour, gap_m = colour[used], gap_m[used]
    if not len(mesh.faces):
        raise InputError(
            "--mesh", "surface", "was seen by no photograph", "give --mesh.no-only-seen or move --crop"
        )
    mesh, used = kept_faces(mesh, in_large_pieces(mesh, config.least_share))
    mesh = settled(mesh, gap_m[used], _FARTHEST_VOXELS * voxel_m)
    files = _write(trimesh, mesh, colour[used], folder)
    return ExportedMesh(files, len(mesh.faces), np.ptp(mesh.position_m, axis=0))


def _write(trimesh: ModuleType, mesh: TriangleMesh, colour: UInt8[NDArray, "v 3"], folder: Path) -> tuple:
    as_ply, as_glb = folder / "mesh.ply", folder / "mesh.glb"
    ply.write_mesh(mesh.position_m, colour, mesh.faces, as_ply)
    scene = trimesh.Scene()
    body = trimesh.Trimesh(mesh.position_m, mesh.faces, vertex_colors=colour, process=False)
    scene.add_geometry(body, geom_name="mesh", node_name="z_up", transform=_T_GLTF_WORLD)
    data = scene.export(file_type="glb")
    write_atomically(as_glb, lambda temporary: temporary.write_bytes(data))
    return as_ply, as_glb
