"""Which parts of a mesh the photographs saw, and in what colours."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from numpy.typing import NDArray

from mulan.export.density_mesh import TriangleMesh
from mulan.export.surface_hits import surface_hits
from mulan.geometry import se3
from mulan.mission.pixels import resized_shape
from mulan.mission.posed_images import PosedImage
from mulan.radiance.engine import RadianceEngine

_DEPTH_SIDE = 160  # longest side of the depth maps that decide what is hidden
_MOST_CAMERAS = 64
_DEPTH_TOLERANCE = 0.03  # of the distance: what a depth map's pixels blur
_STAND_OFF = 4.0  # voxels before the surface where the colour ray begins, past anything in between


@dataclass(frozen=True)
class MeshColours:
    """One entry a vertex.

    Attributes:
        colour: sRGB, from the photograph that looks at it most squarely.
        seen: Whether any photograph looked at it.
    """

    colour: UInt8[NDArray, "v 3"]
    seen: Bool[NDArray, "v"]


def mesh_colours(
    engine: RadianceEngine,
    mesh: TriangleMesh,
    voxel_m: float,
    images: Sequence[PosedImage],
    progress: Callable[[float, float, str], None],
) -> MeshColours:
    """Look at every vertex from the photographs' places.

    A vertex is seen where it faces the camera, lies in its picture, and no deeper than the field's surface
    there. Its colour is what the field shows along that direction; unseen ones are looked at squarely.

    Args:
        engine: The field.
        mesh: Triangles.
        voxel_m: Size of the cells they were made with.
        images: Photographs; at most some dozens spread over them are used.
        progress: Called with what is done.
    """
    chosen = np.linspace(0, len(images) - 1, min(_MOST_CAMERAS, len(images))).round().astype(int)
    normals = mesh.normals()
    best = np.zeros(len(mesh.position_m))
    direction = -normals
    for number, index in enumerate(chosen):
        progress(number, len(chosen) + 1, "")
        image = images[int(index)]
        towards = mesh.position_m - image.T_world_camera[:3, 3]
        distance_m = np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
        towards /= distance_m[:, None]
        squareness = -(towards * normals).sum(1)
        candidate = np.flatnonzero(squareness > best)
        visible = _visible(engine, image, mesh.position_m[candidate], distance_m[candidate], voxel_m)
        better = candidate[visible]
        best[better], direction[better] = squareness[better], towards[better]
    progress(len(chosen), len(chosen) + 1, "colours")
    origin = mesh.position_m - _STAND_OFF * voxel_m * direction
    hits = surface_hits(
        engine,
        torch.from_numpy(origin.astype(np.float32)),
        torch.from_numpy(direction.astype(np.float32)),
    )
    colour = (hits.colour.cpu().numpy() * 255).round().astype(np.uint8)
    return MeshColours(colour, best > 0)


def _visible(
    engine: RadianceEngine,
    image: PosedImage,
    points_m: Float[NDArray, "v 3"],
    distance_m: Float[NDArray, "v"],
    voxel_m: float,
) -> Bool[NDArray, "v"]:
    width, height = resized_shape(image.camera.width, image.camera.height, _DEPTH_SIDE)
    camera = image.camera.resized(width, height)
    R, origin = image.T_world_camera[:3, :3], image.T_world_camera[:3, 3]
    directions = torch.from_numpy((camera.pixel_directions().reshape(-1, 3) @ R.T).astype(np.float32))
    origins = torch.from_numpy(origin.astype(np.float32)).expand(len(directions), 3).contiguous()
    hits = surface_hits(engine, origins, directions)
    depth_m = torch.where(hits.opacity > 0.5, hits.distance_m, torch.inf).cpu().numpy().reshape(height, width)
    points_camera = se3.transform(se3.inverse(image.T_world_camera), points_m)
    with np.errstate(invalid="ignore"):
        column, row = np.floor(camera.project(points_camera)).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    # far off its axis a lens with distortion may fold back into the picture
    half_diagonal = np.hypot(width / camera.fx, height / camera.fy)
    inside &= np.hypot(points_camera[:, 0], points_camera[:, 1]) <= -points_camera[:, 2] * half_diagonal
    result = np.zeros(len(points_m), dtype=bool)
    at = depth_m[row[inside].astype(int), column[inside].astype(int)]
    tolerance_m = 2 * voxel_m + _DEPTH_TOLERANCE * distance_m[inside]
    result[inside] = distance_m[inside] <= at + tolerance_m
    return result
