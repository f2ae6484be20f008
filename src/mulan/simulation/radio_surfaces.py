"""The things of a Mitsuba scene as radio meets them: flat faces of one material each."""

from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.simulation.mitsuba_parts import use_scalar_variant
from mulan.simulation.radio_material import RadioMaterial, radio_material

SMALLEST_M = 0.1
"""Things whose second-longest side is shorter are left out: rays need faces of some wavelengths."""
_ROUND = 8  # sides of a prism in place of a cylinder, and of a polygon in place of a disc
_GOLDEN = (1 + 5**0.5) / 2


@dataclass(frozen=True)
class RadioSurface:
    """One thing of one make.

    Attributes:
        name: What its author called it, and a number that makes it unique.
        material: What it is made of.
        vertices_m: Corners in the world frame.
        triangles: Three corners a face.
    """

    name: str
    material: RadioMaterial
    vertices_m: Float[NDArray, "v 3"]
    triangles: Int[NDArray, "t 3"]


def radio_surfaces(scene: mi.Scene) -> tuple[RadioSurface, ...]:
    """What of a scene reflects radio.

    Left out are lamps (sheets of light without a body, as far as a scene tells), small things and what
    :func:`mulan.simulation.radio_material.radio_material` leaves out. Cylinders become prisms of eight sides,
    discs octagons, spheres icosahedra: finer faces would be smaller than a wavelength.

    Args:
        scene: Loaded in the scalar variant with its shapes unmerged, because materials go by names.

    Raises:
        InputError: A shape is neither a mesh nor one of those, or nothing is left.
    """
    use_scalar_variant()
    found = []
    for shape in scene.shapes():
        surface = shape.bsdf()
        made_of = radio_material((surface.id(), shape.id()), str(surface))
        if made_of is None or shape.is_emitter():
            continue
        vertices_m, triangles = _faces(shape)
        if _second_longest_side_m(vertices_m) >= SMALLEST_M:
            found.append(RadioSurface(f"{len(found)}_{shape.id()}", made_of, vertices_m, triangles))
    if not found:
        raise InputError("scene", "shapes", "hold nothing that reflects radio", "use the built-in radio")
    return tuple(found)


def _faces(shape: Any) -> tuple[Float[NDArray, "v 3"], Int[NDArray, "t 3"]]:
    """Corners and triangles of one shape."""
    parameters: Any = mi.traverse(shape)
    kind = shape.class_name()
    if "vertex_positions" in parameters:
        vertices_m = np.array(parameters["vertex_positions"], dtype=float).reshape(-1, 3)
        return vertices_m, np.array(parameters["faces"], dtype=np.int64).reshape(-1, 3)
    if kind not in _UNIT_SHAPES:
        raise InputError(
            "scene", f"shape '{shape.id()}'", f"is a {kind}, not made of faces", "save it as a mesh (PLY)"
        )
    unit, triangles = _UNIT_SHAPES[kind]
    T = np.array(parameters["to_world"].matrix, dtype=float)
    return unit @ T[:3, :3].T + T[:3, 3], triangles


def _rectangle() -> tuple[Float[NDArray, "4 3"], Int[NDArray, "2 3"]]:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _polygon(height: float) -> Float[NDArray, "sides 3"]:
    """Corners about a circle so that circle and polygon have one area."""
    turn = 2 * np.pi * (np.arange(_ROUND) + 0.5) / _ROUND
    radius = np.sqrt(2 * np.pi / _ROUND / np.sin(2 * np.pi / _ROUND))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(_ROUND, height)], -1)


def _disc() -> tuple[Float[NDArray, "v 3"], Int[NDArray, "t 3"]]:
    k = np.arange(1, _ROUND - 1)
    return _polygon(0.0), np.stack([0 * k, k, k + 1], -1)


def _cylinder() -> tuple[Float[NDArray, "v 3"], Int[NDArray, "t 3"]]:
    k = np.arange(_ROUND)
    after = (k + 1) % _ROUND
    sides = [np.stack([k, after, after + _ROUND], -1), np.stack([k, after + _ROUND, k + _ROUND], -1)]
    return np.concatenate([_polygon(0.0), _polygon(1.0)]), np.concatenate(sides)


def _sphere() -> tuple[Float[NDArray, "12 3"], Int[NDArray, "20 3"]]:
    plane = [(0.0, sign, other * _GOLDEN) for sign in (-1, 1) for other in (-1, 1)]
    corners = np.array([np.roll(corner, turn) for turn in range(3) for corner in plane])
    distance = np.linalg.norm(corners[:, None] - corners, axis=-1)
    near = (distance > 0) & (distance < 2.1)  # edges are 2 long
    triangles = [
        (a, b, c)
        for a in range(12)
        for b in range(a)
        for c in range(b)
        if near[a, b] & near[b, c] & near[a, c]
    ]
    return corners / np.linalg.norm(corners[0]), np.array(triangles)


_UNIT_SHAPES = {
    "Rectangle": _rectangle(),
    "Disk": _disc(),
    "Cylinder": _cylinder(),
    "Sphere": _sphere(),
}


def _second_longest_side_m(vertices_m: Float[NDArray, "v 3"]) -> float:
    """Of the box about some corners along their principal axes."""
    centred = vertices_m - vertices_m.mean(0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    return float(np.sort(np.ptp(centred @ axes.T, axis=0))[-2])
