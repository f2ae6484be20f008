"""A table with a model rover, a globe, books and a mug; stands in the furnished room."""

import mitsuba as mi
import numpy as np

from mulan.simulation import scene_pictures, scene_textures
from mulan.simulation.mitsuba_parts import Node, ball, box, disc, panel, place, plain, textured, tube
from mulan.simulation.scene_rover import rover

TOP_HEIGHT_M = 0.75
_MODEL_SCALE = 0.42


def tabletop(rng: np.random.Generator) -> dict[str, Node]:
    """Table and things, standing on z = 0 at the origin."""
    oak = textured(scene_textures.planks(6, 2, 480, (0.34, 0.20, 0.10), (0.78, 0.56, 0.34), rng))
    wood = plain((0.22, 0.12, 0.06))
    top = TOP_HEIGHT_M
    parts = {
        "table": box(place((0.0, 0.0, top - 0.03)), (1.3, 0.9, 0.06), wood),
        "table_top": panel(place((0.0, 0.0, top + 0.0005)), (1.3, 0.9), oak),
    }
    for k, (x, y) in enumerate(((0.58, 0.38), (0.58, -0.38), (-0.58, 0.38), (-0.58, -0.38))):
        parts[f"table_leg_{k}"] = tube((x, y, 0.0), (x, y, top - 0.06), 0.03, wood)
    return parts | _model(rng) | _things(rng)


def _model(rng: np.random.Generator) -> dict[str, Node]:
    """The rover as a toy."""
    T = mi.ScalarTransform4f(place((-0.05, 0.02, TOP_HEIGHT_M), yaw_deg=25.0).tolist())
    T = T @ mi.ScalarTransform4f().scale(_MODEL_SCALE)
    parts = rover(rng)
    for part in parts.values():
        part["to_world"] = T @ part.get("to_world", mi.ScalarTransform4f())
    return {f"model_{name}": part for name, part in parts.items()}


def _things(rng: np.random.Generator) -> dict[str, Node]:
    top = TOP_HEIGHT_M
    globe = textured(scene_textures.globe(512, rng), shine=0.2)
    banded = textured(scene_textures.stripes(4, 128, (0.92, 0.90, 0.86), (0.12, 0.40, 0.42)))
    chart = textured(scene_pictures.chart_poster(256))
    parts = {
        "globe": ball(place((0.42, 0.24, top + 0.20), roll_deg=23.0), 0.14, globe),
        "globe_foot": tube((0.42, 0.24, top), (0.42, 0.24, top + 0.07), 0.06, plain((0.15, 0.09, 0.05))),
        "mug": tube((0.40, -0.25, top), (0.40, -0.25, top + 0.11), 0.045, banded),
        "mug_tea": disc(place((0.40, -0.25, top + 0.09)), 0.044, plain((0.20, 0.08, 0.02))),
        "card": box(
            place((-0.52, 0.20, top + 0.11), yaw_deg=65.0), (0.22, 0.012, 0.22), plain((0.9, 0.9, 0.88))
        ),
        "card_face": panel(
            place((-0.52, 0.20, top + 0.11), yaw_deg=65.0) @ place((0.0, -0.0065, 0.0), roll_deg=90.0),
            (0.21, 0.21),
            chart,
        ),
    }
    covers = ((0.62, 0.12, 0.13), (0.09, 0.20, 0.38), (0.86, 0.52, 0.14), (0.12, 0.42, 0.40))
    for k, cover in enumerate(covers):
        striped = textured(scene_textures.stripes(3 + k, 128, cover, (0.93, 0.88, 0.78)))
        size = (0.26 - 0.02 * k, 0.18 - 0.015 * k, 0.035)
        spot = (-0.42, -0.24, top + 0.0175 + 0.035 * k)
        parts[f"book_{k}"] = box(place(spot, yaw_deg=15.0 * k - 10.0), size, striped)
    return parts
