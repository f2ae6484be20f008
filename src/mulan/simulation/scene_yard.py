"""A yard under an open sky: a fountain on paving, lawn, fence, a shed, trees, a bench."""

import numpy as np

from mulan.simulation import scene_pictures, scene_textures
from mulan.simulation.mitsuba_parts import Node, ball, box, disc, facing, panel, place, plain, textured, tube
from mulan.simulation.scene_lights import sky, sun

_HALF_X_M, _HALF_Y_M = 7.0, 6.0


def yard(rng: np.random.Generator) -> dict[str, Node]:
    """Everything, the sky included; the ground is z = 0, the fountain stands at the origin."""
    return _ground(rng) | _fountain(rng) | _fence(rng) | _shed(rng) | _trees(rng) | _bench(rng) | _sky()


def _sky() -> dict[str, Node]:
    return {
        "sky": sky(0.75, (0.62, 0.78, 1.0)),
        "sun": sun((-0.5, 0.35, -0.8), 2.6, (1.0, 0.94, 0.82)),
    }


def _ground(rng: np.random.Generator) -> dict[str, Node]:
    grass = textured(scene_textures.leaves(512, rng), repeat=(7.0, 6.0))
    paving = textured(scene_textures.bricks(24, 16, 960, rng))
    return {
        "lawn": panel(place((0.0, 0.0, 0.0)), (40.0, 40.0), grass),
        "paving": panel(place((0.0, 0.0, 0.008)), (7.2, 7.2), paving),
    }


def _fountain(rng: np.random.Generator) -> dict[str, Node]:
    stone = textured(scene_textures.bricks(5, 26, 640, rng))
    banded = textured(scene_textures.stripes(6, 128, (0.80, 0.76, 0.68), (0.34, 0.42, 0.46)))
    globe = textured(scene_textures.globe(512, rng), shine=0.2)
    clay = textured(scene_textures.stripes(4, 128, (0.76, 0.36, 0.20), (0.62, 0.26, 0.14)))
    foliage = textured(scene_textures.leaves(256, rng))
    rim = plain((0.70, 0.67, 0.60))
    parts = {
        "basin": tube((0.0, 0.0, 0.0), (0.0, 0.0, 0.38), 0.85, stone),
        "water": disc(place((0.0, 0.0, 0.30)), 0.85, plain((0.05, 0.25, 0.36), shine=0.1)),
        "column": tube((0.0, 0.0, 0.25), (0.0, 0.0, 0.95), 0.14, banded),
        "bowl": ball(place((0.0, 0.0, 0.98)), 0.1, rim),
        "plate": disc(place((0.0, 0.0, 0.92)), 0.46, rim),
        "plate_edge": tube((0.0, 0.0, 0.88), (0.0, 0.0, 0.94), 0.46, banded),
        "globe": ball(place((0.0, 0.0, 1.24), roll_deg=23.0), 0.27, globe),
    }
    for k in range(4):
        angle = np.pi / 4 + k * np.pi / 2
        x, y = 1.18 * np.cos(angle), 1.18 * np.sin(angle)
        parts[f"pot_{k}"] = tube((x, y, 0.0), (x, y, 0.30), 0.15, clay)
        parts[f"bush_{k}"] = ball(place((x, y, 0.42), yaw_deg=50.0 * k), 0.19, foliage)
    return parts


def _fence(rng: np.random.Generator) -> dict[str, Node]:
    boards = textured(
        scene_textures.planks(18, 1, 720, (0.30, 0.20, 0.12), (0.66, 0.48, 0.30), rng).swapaxes(0, 1).copy(),
        repeat=(3.0, 1.0),
    )
    x, y, high = _HALF_X_M, _HALF_Y_M, 1.7
    parts = {
        "fence_north": panel(facing((0.0, y, high / 2), -90.0), (2 * x, high), boards),
        "fence_south": panel(facing((0.0, -y, high / 2), 90.0), (2 * x, high), boards),
        "fence_east": panel(facing((x, 0.0, high / 2), 180.0), (2 * y, high), boards),
        "fence_west": panel(facing((-x, 0.0, high / 2), 0.0), (2 * y, high), boards),
    }
    planet = textured(scene_pictures.planet_poster(384, rng))
    chart = textured(scene_pictures.chart_poster(384))
    parts["banner"] = panel(facing((2.2, -y + 0.03, 0.95), 90.0), (1.1, 1.4), planet)
    parts["sign"] = panel(facing((x - 0.03, -2.6, 0.95), 180.0), (1.2, 1.2), chart)
    return parts


def _shed(rng: np.random.Generator) -> dict[str, Node]:
    wall = textured(scene_textures.bricks(16, 12, 640, rng))
    roof = textured(scene_textures.chevrons(8, 256, (0.50, 0.18, 0.12), (0.32, 0.10, 0.08)))
    view = textured(scene_pictures.landscape(384, rng))
    door = textured(scene_textures.stripes(4, 256, (0.10, 0.30, 0.26), (0.08, 0.24, 0.20)))
    return {
        "shed": box(place((-5.0, 4.2, 1.1)), (2.8, 2.2, 2.2), wall),
        "shed_roof_front": box(place((-5.0, 3.55, 2.5), roll_deg=30.0), (3.2, 1.6, 0.06), roof),
        "shed_roof_back": box(place((-5.0, 4.85, 2.5), roll_deg=-30.0), (3.2, 1.6, 0.06), roof),
        "shed_door": panel(facing((-5.6, 3.09, 0.95), -90.0), (0.9, 1.9), door),
        "shed_window": panel(facing((-4.4, 3.09, 1.3), -90.0), (0.9, 0.8), view),
    }


def _trees(rng: np.random.Generator) -> dict[str, Node]:
    bark = textured(scene_textures.stripes(12, 256, (0.24, 0.15, 0.09), (0.16, 0.10, 0.06)))
    foliage = textured(scene_textures.leaves(256, rng))
    parts: dict[str, Node] = {}
    for tree, (x, y, high) in enumerate(((5.0, 3.9, 1.9), (-5.2, -4.0, 1.6), (0.6, 5.0, 1.4))):
        parts[f"trunk_{tree}"] = tube((x, y, 0.0), (x, y, high), 0.14, bark)
        for k in range(12):
            angle, radius = 2.4 * k, 0.75 * np.sqrt((k + 0.5) / 12)
            spot = np.array([x + radius * np.cos(angle), y + radius * np.sin(angle), high + 0.08 * k])
            leaf = ball(
                place(spot, yaw_deg=40.0 * k, roll_deg=25.0 * k), float(rng.uniform(0.35, 0.55)), foliage
            )
            parts[f"crown_{tree}_{k}"] = leaf
    return parts


def _bench(rng: np.random.Generator) -> dict[str, Node]:
    boards = textured(scene_textures.planks(4, 1, 256, (0.34, 0.20, 0.10), (0.78, 0.56, 0.34), rng))
    iron = plain((0.10, 0.10, 0.11))
    parts = {
        "bench_seat": box(place((4.6, -0.3, 0.45)), (0.5, 1.8, 0.05), boards),
        "bench_back": box(place((4.86, -0.3, 0.78), pitch_deg=-8.0), (0.05, 1.8, 0.45), boards),
    }
    for k, y in enumerate((-1.05, 0.45)):
        parts[f"bench_leg_{k}"] = box(place((4.6, y, 0.21)), (0.45, 0.06, 0.42), iron)
    return parts
