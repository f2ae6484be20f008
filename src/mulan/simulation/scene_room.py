"""The built-in scene's surroundings: walls, floor, rug, windows, posters, furniture, a plant."""

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.simulation import scene_pictures, scene_textures
from mulan.simulation.mitsuba_parts import Node, ball, box, disc, facing, panel, place, plain, textured, tube

_OAK: tuple[scene_textures.Colour, scene_textures.Colour] = ((0.34, 0.20, 0.10), (0.78, 0.56, 0.34))
_WALNUT: tuple[scene_textures.Colour, scene_textures.Colour] = ((0.20, 0.11, 0.06), (0.52, 0.33, 0.19))


def room(width_m: float, depth_m: float, height_m: float, rng: np.random.Generator) -> dict[str, Node]:
    """Everything but the rover and the light; floor at z = 0, centred on the origin."""
    shell = _shell(width_m, depth_m, height_m, rng)
    return shell | _pictures(width_m, depth_m, rng) | _furniture(width_m, depth_m, rng)


def _shell(width_m: float, depth_m: float, height_m: float, rng: np.random.Generator) -> dict[str, Node]:
    x, y, z = width_m / 2, depth_m / 2, height_m / 2
    parquet = textured(scene_textures.planks(10, 3, 900, *_OAK, rng), repeat=(2.0, 2.0))
    brick = textured(scene_textures.bricks(20, 14, 840, rng), repeat=(1.5, 1.0))
    boards = textured(scene_textures.planks(9, 2, 720, *_WALNUT, rng), repeat=(2.0, 1.0))
    paper = textured(
        scene_textures.damask(8, 640, (0.14, 0.34, 0.36), (0.80, 0.74, 0.52), rng), repeat=(2.0, 1.0)
    )
    lime = textured(scene_textures.plaster(512, (0.92, 0.82, 0.62), rng))
    parts = {
        "floor": panel(place((0.0, 0.0, 0.0)), (width_m, depth_m), parquet),
        "wall_north": panel(facing((0.0, y, z), -90.0), (width_m, height_m), brick),
        "wall_south": panel(facing((0.0, -y, z), 90.0), (width_m, height_m), paper),
        "wall_east": panel(facing((x, 0.0, z), 180.0), (depth_m, height_m), lime),
        "wall_west": panel(facing((-x, 0.0, z), 0.0), (depth_m, height_m), boards),
        "rug": panel(place((0.0, 0.0, 0.006)), (3.0, 2.5), textured(scene_textures.kilim(640, rng))),
    }
    skirting = plain((0.82, 0.80, 0.74))
    for sign in (1.0, -1.0):
        side = "plus" if sign > 0 else "minus"
        parts[f"skirting_x_{side}"] = box(
            place((sign * (x - 0.015), 0.0, 0.06)), (0.03, depth_m, 0.12), skirting
        )
        parts[f"skirting_y_{side}"] = box(
            place((0.0, sign * (y - 0.015), 0.06)), (width_m, 0.03, 0.12), skirting
        )
    return parts


def _framed(
    name: str, T: Float[NDArray, "4 4"], size_m: tuple[float, float], picture: Node, frame: Node
) -> dict[str, Node]:
    """A picture proud of its wall, in a frame."""
    return {
        name: panel(T @ place((0.0, 0.0, 0.045)), size_m, picture),
        f"{name}_frame": box(T @ place((0.0, 0.0, 0.02)), (size_m[0] + 0.1, size_m[1] + 0.1, 0.04), frame),
    }


def _pictures(width_m: float, depth_m: float, rng: np.random.Generator) -> dict[str, Node]:
    x, y = width_m / 2, depth_m / 2
    black, white = plain((0.04, 0.04, 0.05)), plain((0.85, 0.85, 0.83))
    view = textured(scene_pictures.landscape(512, rng))
    mandelbrot = textured(scene_pictures.mandelbrot_poster(512))
    planet = textured(scene_pictures.planet_poster(512, rng))
    chart = textured(scene_pictures.chart_poster(512))
    parts = _framed("window_left", facing((x, 1.35, 1.55), 180.0), (1.5, 1.3), view, white)
    parts |= _framed("window_right", facing((x, -1.15, 1.55), 180.0), (1.5, 1.3), view, white)
    for name, at in (("left", 1.35), ("right", -1.15)):
        parts[f"bar_{name}_upright"] = box(place((x - 0.05, at, 1.55)), (0.03, 0.05, 1.3), white)
        parts[f"bar_{name}_level"] = box(place((x - 0.05, at, 1.55)), (0.03, 1.5, 0.05), white)
        parts[f"sill_{name}"] = box(place((x - 0.1, at, 0.87)), (0.2, 1.7, 0.05), white)
    parts |= _framed("mandelbrot", facing((-1.9, -y, 1.45), 90.0), (1.3, 1.2), mandelbrot, black)
    parts |= _framed("planet", facing((0.1, -y, 1.4), 90.0), (1.0, 1.4), planet, black)
    parts |= _framed("chart", facing((2.0, -y, 1.45), 90.0), (1.1, 1.1), chart, white)
    parts |= _framed("planet_west", facing((-x, 1.6, 1.5), 0.0), (0.9, 1.2), planet, white)
    parts |= _framed("mandelbrot_north", facing((1.7, y, 1.5), -90.0), (1.1, 1.1), mandelbrot, black)
    return parts


def _furniture(width_m: float, depth_m: float, rng: np.random.Generator) -> dict[str, Node]:
    x, y = width_m / 2, depth_m / 2
    planked = scene_textures.planks(6, 1, 384, *_OAK, rng)
    crates = [textured(scene_pictures.crate_panel(planked, label)) for label in ("CSI", "UWB", "NeRF")]
    shelf = textured(scene_textures.books(4, 512, rng))
    foliage = textured(scene_textures.leaves(256, rng))
    clay = textured(scene_textures.stripes(4, 128, (0.76, 0.36, 0.20), (0.62, 0.26, 0.14)))
    globe_map = textured(scene_textures.globe(512, rng), shine=0.2)
    wood = plain((0.22, 0.12, 0.06))
    parts = {
        "crate_0": box(place((-x + 0.55, y - 0.55, 0.35), yaw_deg=12.0), (0.7, 0.7, 0.7), crates[0]),
        "crate_1": box(place((-x + 1.35, y - 0.45, 0.28), yaw_deg=-8.0), (0.56, 0.56, 0.56), crates[1]),
        "crate_2": box(place((-x + 0.62, y - 0.5, 0.93), yaw_deg=35.0), (0.46, 0.46, 0.46), crates[2]),
        "crate_3": box(place((x - 0.5, -y + 0.5, 0.32), yaw_deg=20.0), (0.64, 0.64, 0.64), crates[2]),
        "globe": ball(place((x - 0.5, -y + 0.5, 0.93), roll_deg=23.0), 0.27, globe_map),
        "globe_foot": tube((x - 0.5, -y + 0.5, 0.63), (x - 0.5, -y + 0.5, 0.7), 0.1, wood),
        "shelf": box(place((-x + 0.17, -0.9, 0.8)), (0.34, 1.6, 1.6), wood),
        "shelf_books": panel(facing((-x + 0.345, -0.9, 0.8), 0.0), (1.52, 1.52), shelf),
        "pot": tube((x - 0.6, y - 0.6, 0.0), (x - 0.6, y - 0.6, 0.42), 0.24, clay),
        "soil": disc(place((x - 0.6, y - 0.6, 0.40)), 0.24, plain((0.06, 0.04, 0.03))),
        "trunk": tube((x - 0.6, y - 0.6, 0.4), (x - 0.6, y - 0.6, 1.0), 0.035, wood),
    }
    for k in range(14):
        angle, radius = 2.4 * k, 0.30 * np.sqrt((k + 0.5) / 14)
        spot = np.array([x - 0.6 + radius * np.cos(angle), y - 0.6 + radius * np.sin(angle), 0.92 + 0.05 * k])
        parts[f"leaf_{k}"] = ball(
            place(spot, yaw_deg=40.0 * k, roll_deg=25.0 * k), float(rng.uniform(0.13, 0.2)), foliage
        )
    return parts
