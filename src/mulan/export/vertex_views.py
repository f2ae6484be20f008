"""Which parts of a mesh the photographs saw, in what colours, and where they saw the surface."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from numpy.typing import NDArray

from mulan.export.density_mesh import TriangleMesh
from mulan.export.surface_hits import surface_hits
from mulan.geometry import se3
from mulan.mission.posed_images import PosedImage
from mulan.radiance.engine import RadianceEngine

_MOST_CAMERAS = 128
_TRIES = 5  # cameras a vertex is looked at from before it counts as unseen
_MOST_HIDDEN = 0.5  # opacity between camera and vertex up to which it is seen
_LEAST_SHARPNESS = 0.7  # of a ray whose surface is believed
_STAND_OFF = 4.0  # voxels before an unseen vertex where its colour ray begins


@dataclass(frozen=True)
class VertexViews:
    """One entry a vertex.

    Attributes:
        colour: What the field shows towards the photograph that looks at it most squarely (sRGB); of unseen
            vertices, what it shows squarely from close by.
        seen: Whether any photograph looked at it.
        gap_m: How far outwards the surface lies, where half of that photograph's light has stopped; NaN where
            unseen or where that is two surfaces.
    """

    colour: UInt8[NDArray, "v 3"]
    seen: Bool[NDArray, "v"]
    gap_m: Float[NDArray, "v"]


def vertex_views(
    engine: RadianceEngine,
    mesh: TriangleMesh,
    voxel_m: float,
    images: Sequence[PosedImage],
    progress: Callable[[float, float, str], None],
) -> VertexViews:
    """Look at every vertex from the photographs' places.

    A vertex is seen where it faces the camera, lies in its picture, and not half of the light is stopped
    before it. The squarest few cameras of each are tried.

    Args:
        engine: The field.
        mesh: Triangles.
        voxel_m: Size of the cells they were made with.
        images: Photographs; a hundred or so spread over them are used.
        progress: Called with what is done.
    """
    chosen = np.linspace(0, len(images) - 1, min(_MOST_CAMERAS, len(images))).round().astype(int)
    cameras = [images[int(index)] for index in np.unique(chosen)]
    normals = mesh.normals()
    squarest = _squarest(mesh.position_m, normals, cameras)
    centre_m = np.stack([image.T_world_camera[:3, 3] for image in cameras])
    seen = np.zeros(len(normals), dtype=bool)
    colour, gap_m = np.zeros((len(normals), 3), np.uint8), np.full(len(normals), np.nan)
    for turn, camera in enumerate(squarest.T):
        progress(turn, _TRIES + 1, "what was seen")
        left = np.flatnonzero(~seen & (camera >= 0))
        origin = centre_m[camera[left]]
        look = _look(engine, origin, mesh.position_m[left], voxel_m)
        visible = look.hidden < _MOST_HIDDEN
        now = left[visible]
        seen[now], colour[now] = True, look.colour[visible]
        gap_m[now] = np.where(
            look.sharpness[visible] > _LEAST_SHARPNESS, (look.beyond_m[visible] * normals[now]).sum(1), np.nan
        )
    progress(_TRIES, _TRIES + 1, "colours of what was not")
    rest = np.flatnonzero(~seen)
    origin = mesh.position_m[rest] + _STAND_OFF * voxel_m * normals[rest]
    colour[rest] = _look(engine, origin, mesh.position_m[rest], voxel_m).colour
    return VertexViews(colour, seen, gap_m)


def _squarest(
    position_m: Float[NDArray, "v 3"], normals: Float[NDArray, "v 3"], cameras: Sequence[PosedImage]
) -> Int[NDArray, "v tries"]:
    """The cameras that look at each vertex most squarely, -1 where fewer have it in their pictures."""
    best = np.zeros((len(position_m), _TRIES), np.float32)
    which = np.full((len(position_m), _TRIES), -1, np.int64)
    for number, image in enumerate(cameras):
        towards = position_m - image.T_world_camera[:3, 3]
        squareness = -(towards * normals).sum(1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
        candidate = np.flatnonzero(squareness > best[:, -1])
        candidate = candidate[_in_picture(image, position_m[candidate])]
        best[candidate, -1], which[candidate, -1] = squareness[candidate], number
        order = np.argsort(-best[candidate], axis=1, kind="stable")
        best[candidate] = np.take_along_axis(best[candidate], order, 1)
        which[candidate] = np.take_along_axis(which[candidate], order, 1)
    return which


def _in_picture(image: PosedImage, points_m: Float[NDArray, "v 3"]) -> Bool[NDArray, "v"]:
    T_camera_world = se3.inverse(image.T_world_camera)
    points_camera = points_m @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    camera = image.camera
    with np.errstate(invalid="ignore"):
        column, row = camera.project(points_camera).T
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    # far off its axis a lens with distortion may fold back into the picture
    diagonal = np.hypot(camera.width / camera.fx, camera.height / camera.fy)
    return inside & (np.hypot(points_camera[:, 0], points_camera[:, 1]) <= -points_camera[:, 2] * diagonal)


@dataclass(frozen=True)
class _Look:
    """What rays to targets saw.

    Attributes:
        colour: Of each ray.
        hidden: Light stopped before the target.
        sharpness: Share of what was stopped that lies where half is.
        beyond_m: From the target to where half of the light has stopped, as a world vector.
    """

    colour: UInt8[NDArray, "v 3"]
    hidden: Float[NDArray, "v"]
    sharpness: Float[NDArray, "v"]
    beyond_m: Float[NDArray, "v 3"]


def _look(
    engine: RadianceEngine, origin: Float[NDArray, "v 3"], target: Float[NDArray, "v 3"], voxel_m: float
) -> _Look:
    if not len(origin):
        return _Look(np.zeros((0, 3), np.uint8), np.zeros(0), np.zeros(0), np.zeros((0, 3)))
    towards = target - origin
    distance_m = np.linalg.norm(towards, axis=1)
    direction = towards / np.maximum(distance_m, 1e-9)[:, None]
    hits = surface_hits(
        engine,
        torch.from_numpy(origin.astype(np.float32)),
        torch.from_numpy(direction.astype(np.float32)),
        torch.from_numpy((distance_m - voxel_m).astype(np.float32)),
    )
    colour = (hits.colour.cpu().numpy() * 255).round().astype(np.uint8)
    beyond_m = hits.distance_m.double().cpu().numpy() - distance_m
    hidden, sharpness = (each.double().cpu().numpy() for each in (hits.hidden, hits.sharpness))
    return _Look(colour, hidden, sharpness, beyond_m[:, None] * direction)
