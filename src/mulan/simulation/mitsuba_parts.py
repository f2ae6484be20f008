"""Small vocabulary of Mitsuba scene dictionaries: textured boxes, balls, tubes, discs, pictures."""

from typing import Any

import mitsuba as mi
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from mulan.geometry import se3, so3

Node = dict[str, Any]
"""One Mitsuba plugin as a dictionary."""
Point = tuple[float, float, float] | NDArray
"""Three coordinates in metres."""


def use_scalar_variant() -> None:
    """Choose Mitsuba's scalar variant, the one that needs neither LLVM nor a GPU."""
    if mi.variant() != "scalar_rgb":
        mi.set_variant("scalar_rgb")


use_scalar_variant()  # Mitsuba has no types to annotate with before a variant is chosen


def place(
    position_m: Point,
    yaw_deg: float = 0.0,
    pitch_deg: float = 0.0,
    roll_deg: float = 0.0,
) -> Float[NDArray, "4 4"]:
    """Pose of a part: yaw about z, then pitch about y, then roll about x."""
    w = np.deg2rad(np.array([[0.0, 0.0, yaw_deg], [0.0, pitch_deg, 0.0], [roll_deg, 0.0, 0.0]]))
    Rz, Ry, Rx = so3.exp(w)
    return se3.from_parts(Rz @ Ry @ Rx, np.array(position_m, dtype=float))


def facing(position_m: Point, heading_deg: float) -> Float[NDArray, "4 4"]:
    """Pose of an upright picture that faces a heading."""
    yaw = np.deg2rad(heading_deg)
    normal, up = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([0.0, 0.0, 1.0])
    return se3.from_parts(np.stack([np.cross(up, normal), up, normal], -1), np.array(position_m, dtype=float))


def textured(
    image: UInt8[NDArray, "h w 3"], repeat: tuple[float, float] = (1.0, 1.0), shine: float | None = None
) -> Node:
    """A surface that wears a bitmap; ``shine`` is the roughness of a clear coat."""
    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(image[::-1])),  # v grows upwards
        "to_uv": mi.ScalarTransform4f().scale([repeat[0], repeat[1], 1.0]),
    }
    return _surface(texture, shine)


def plain(tone: tuple[float, float, float], shine: float | None = None) -> Node:
    """A surface of one linear RGB reflectance."""
    return _surface({"type": "rgb", "value": list(tone)}, shine)


def _surface(reflectance: Node, shine: float | None) -> Node:
    if shine is None:
        inner = {"type": "diffuse", "reflectance": reflectance}
    else:
        inner = {"type": "roughplastic", "diffuse_reflectance": reflectance, "alpha": shine}
    return {"type": "twosided", "bsdf": inner}


def _transform(T: Float[NDArray, "4 4"], scale: tuple[float, float, float]) -> mi.ScalarTransform4f:
    return mi.ScalarTransform4f((T @ np.diag([*scale, 1.0])).tolist())


def box(T: Float[NDArray, "4 4"], size_m: tuple[float, float, float], surface: Node) -> Node:
    """A box centred on a pose."""
    half = (size_m[0] / 2, size_m[1] / 2, size_m[2] / 2)
    return {"type": "cube", "to_world": _transform(T, half), "bsdf": surface}


def panel(T: Float[NDArray, "4 4"], size_m: tuple[float, float], surface: Node) -> Node:
    """A rectangle in the xy plane of a pose, facing +z, its picture upright along +y."""
    return {
        "type": "rectangle",
        "to_world": _transform(T, (size_m[0] / 2, size_m[1] / 2, 1.0)),
        "bsdf": surface,
    }


def ball(T: Float[NDArray, "4 4"], radius_m: float, surface: Node) -> Node:
    """A sphere, poles along z of the pose."""
    return {"type": "sphere", "to_world": _transform(T, (radius_m, radius_m, radius_m)), "bsdf": surface}


def disc(T: Float[NDArray, "4 4"], radius_m: float, surface: Node) -> Node:
    """A disc in the xy plane of a pose."""
    return {"type": "disk", "to_world": _transform(T, (radius_m, radius_m, 1.0)), "bsdf": surface}


def tube(start_m: Point, end_m: Point, radius_m: float, surface: Node) -> Node:
    """An open cylinder between two points."""
    ends = {"p0": [float(x) for x in start_m], "p1": [float(x) for x in end_m]}
    return {"type": "cylinder", **ends, "radius": radius_m, "bsdf": surface}
