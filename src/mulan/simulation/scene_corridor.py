"""An indoor corridor with two corners: walls of different make, doors, posters, crates, plants."""

import numpy as np

from mulan.simulation import scene_pictures, scene_textures
from mulan.simulation.mitsuba_parts import Node, ball, box, facing, panel, place, plain, textured, tube
from mulan.simulation.scene_lights import lamp

HEIGHT_M = 2.5
MIDDLE_M = ((-4.6, -2.5), (0.0, -2.5), (0.0, 2.5), (4.6, 2.5))
"""The middle of the corridor from one end to the other; it is 2 m wide."""
_END_M, _HALF_M, _TURN_M = 5.0, 1.0, 2.5


def corridor(rng: np.random.Generator) -> dict[str, Node]:
    """Everything; floor at z = 0."""
    return _floor_and_ceiling(rng) | _walls(rng) | _decoration(rng)


def _floor_and_ceiling(rng: np.random.Generator) -> dict[str, Node]:
    tiles = textured(scene_textures.bricks(12, 8, 720, rng), repeat=(3.0, 2.0))
    white = plain((0.8, 0.8, 0.8))
    wide, deep = 2 * _END_M, 2 * (_TURN_M + _HALF_M)
    parts = {
        "floor": panel(place((0.0, 0.0, 0.0)), (wide, deep), tiles),
        "ceiling": panel(place((0.0, 0.0, HEIGHT_M), pitch_deg=180.0), (wide, deep), white),
    }
    spots = ((-4.0, -2.5), (-1.8, -2.5), (0.0, -1.2), (0.0, 1.2), (1.8, 2.5), (4.0, 2.5))
    for k, (x, y) in enumerate(spots):
        parts[f"lamp_{k}"] = lamp((x, y, HEIGHT_M - 0.01), (0.9, 0.9), 10.0, (1.0, 0.96, 0.9))
    return parts


def _walls(rng: np.random.Generator) -> dict[str, Node]:
    brick = textured(scene_textures.bricks(20, 14, 840, rng), repeat=(1.5, 1.0))
    boards = textured(
        scene_textures.planks(9, 2, 720, (0.20, 0.11, 0.06), (0.52, 0.33, 0.19), rng), repeat=(2.0, 1.0)
    )
    paper = textured(
        scene_textures.damask(8, 640, (0.14, 0.34, 0.36), (0.80, 0.74, 0.52), rng), repeat=(2.0, 1.0)
    )
    lime = textured(scene_textures.plaster(512, (0.92, 0.82, 0.62), rng))
    leafy = textured(scene_textures.leaves(512, rng), repeat=(2.0, 1.0))
    inner, outer, end = _TURN_M - _HALF_M, _TURN_M + _HALF_M, _END_M
    # begin, end and heading of the side that is seen
    runs = {
        "south": ((-end, -outer), (_HALF_M, -outer), 90.0, paper),
        "inner_south": ((-end, -inner), (-_HALF_M, -inner), -90.0, boards),
        "east": ((_HALF_M, -outer), (_HALF_M, inner), 180.0, lime),
        "west": ((-_HALF_M, -inner), (-_HALF_M, outer), 0.0, brick),
        "inner_north": ((_HALF_M, inner), (end, inner), 90.0, leafy),
        "north": ((-_HALF_M, outer), (end, outer), -90.0, paper),
        "end_west": ((-end, -outer), (-end, -inner), 0.0, lime),
        "end_east": ((end, inner), (end, outer), 180.0, brick),
    }
    parts = {}
    for name, (begin, finish, heading_deg, surface) in runs.items():
        (x0, y0), (x1, y1) = begin, finish
        middle = ((x0 + x1) / 2, (y0 + y1) / 2, HEIGHT_M / 2)
        size_m = (abs(x1 - x0) + abs(y1 - y0), HEIGHT_M)
        parts[f"wall_{name}"] = panel(facing(middle, heading_deg), size_m, surface)
    return parts


def _decoration(rng: np.random.Generator) -> dict[str, Node]:
    inner, outer = _TURN_M - _HALF_M, _TURN_M + _HALF_M
    mandelbrot = textured(scene_pictures.mandelbrot_poster(384))
    planet = textured(scene_pictures.planet_poster(384, rng))
    chart = textured(scene_pictures.chart_poster(384))
    view = textured(scene_pictures.landscape(384, rng))
    door = textured(scene_textures.stripes(4, 256, (0.55, 0.12, 0.10), (0.48, 0.09, 0.08)))
    blue = textured(scene_textures.stripes(3, 256, (0.10, 0.26, 0.50), (0.08, 0.20, 0.42)))
    planked = scene_textures.planks(6, 1, 256, (0.34, 0.20, 0.10), (0.78, 0.56, 0.34), rng)
    crates = [textured(scene_pictures.crate_panel(planked, label)) for label in ("CSI", "UWB", "NeRF")]
    globe = textured(scene_textures.globe(384, rng), shine=0.2)
    foliage = textured(scene_textures.leaves(256, rng))
    clay = textured(scene_textures.stripes(4, 128, (0.76, 0.36, 0.20), (0.62, 0.26, 0.14)))
    parts = {
        "mandelbrot": panel(facing((-3.4, -outer + 0.02, 1.45), 90.0), (1.1, 1.0), mandelbrot),
        "planet": panel(facing((_HALF_M - 0.02, -2.6, 1.4), 180.0), (0.9, 1.2), planet),
        "chart": panel(facing((_HALF_M - 0.02, 0.3, 1.45), 180.0), (1.1, 1.1), chart),
        "window": panel(facing((-_HALF_M + 0.02, 2.6, 1.5), 0.0), (1.3, 1.1), view),
        "planet_north": panel(facing((2.2, outer - 0.02, 1.45), -90.0), (1.0, 1.3), planet),
        "mandelbrot_end": panel(facing((_END_M - 0.02, 2.5, 1.45), 180.0), (1.1, 1.1), mandelbrot),
        "door_south": box(place((-1.2, -outer + 0.02, 1.0)), (0.9, 0.04, 2.0), door),
        "door_west": box(place((-_HALF_M + 0.02, -0.2, 1.0)), (0.04, 0.9, 2.0), blue),
        "door_north": box(place((3.6, inner + 0.02, 1.0)), (0.9, 0.04, 2.0), door),
        "crate_0": box(place((-4.7, -inner - 0.28, 0.22), yaw_deg=8.0), (0.42, 0.42, 0.42), crates[0]),
        "crate_1": box(place((0.72, -outer + 0.28, 0.2), yaw_deg=-12.0), (0.4, 0.4, 0.4), crates[1]),
        "crate_2": box(place((-0.74, outer - 0.26, 0.19), yaw_deg=20.0), (0.38, 0.38, 0.38), crates[2]),
        "globe": ball(place((0.72, -outer + 0.28, 0.58), roll_deg=23.0), 0.18, globe),
        "pot": tube((4.72, inner + 0.25, 0.0), (4.72, inner + 0.25, 0.4), 0.18, clay),
    }
    for k in range(9):
        angle, radius = 2.4 * k, 0.16 * np.sqrt((k + 0.5) / 9)
        spot = np.array(
            [4.72 + radius * np.cos(angle), inner + 0.27 + radius * np.sin(angle), 0.5 + 0.06 * k]
        )
        parts[f"leaf_{k}"] = ball(place(spot, yaw_deg=40.0 * k), float(rng.uniform(0.08, 0.13)), foliage)
    return parts
