"""The built-in scene's subject: a planetary rover of textured primitives, about 1.2 m long and 1.2 m high."""

import numpy as np

from mulan.geometry import se3
from mulan.simulation import scene_pictures, scene_textures
from mulan.simulation.mitsuba_parts import Node, ball, box, disc, facing, panel, place, plain, textured, tube

_METAL = (0.55, 0.56, 0.58)
_DARK = (0.05, 0.05, 0.06)


def rover(rng: np.random.Generator) -> dict[str, Node]:
    """All parts, standing on z = 0 at the origin, looking along +x."""
    return _hull(rng) | _wheels() | _solar_wings(rng) | _mast() | _dish() | _stern()


def _hull(rng: np.random.Generator) -> dict[str, Node]:
    side = textured(scene_pictures.hull_panel(192, "MULAN-1", rng))
    bow = textured(scene_textures.stripes(5, 128, (0.93, 0.35, 0.10), (0.95, 0.92, 0.86)))
    deck = textured(scene_textures.solar_cells(5, 7, 420, rng), shine=0.2)
    gold = textured(scene_textures.plaster(256, (1.0, 0.72, 0.2), rng), shine=0.15)
    return {
        "hull": box(place((0.0, 0.0, 0.42)), (0.88, 0.50, 0.26), plain((0.72, 0.70, 0.66))),
        "hull_left": panel(facing((0.0, 0.2505, 0.42), 90.0), (0.88, 0.26), side),
        "hull_right": panel(facing((0.0, -0.2505, 0.42), -90.0), (0.88, 0.26), side),
        "hull_bow": panel(facing((0.4405, 0.0, 0.42), 0.0), (0.50, 0.26), bow),
        "hull_stern": panel(facing((-0.4405, 0.0, 0.42), 180.0), (0.50, 0.26), bow),
        "deck": panel(place((0.0, 0.0, 0.5505)), (0.84, 0.46), deck),
        "belly": box(place((0.0, 0.0, 0.27)), (0.60, 0.34, 0.05), gold),
    }


def _wheels() -> dict[str, Node]:
    tread = textured(scene_textures.chevrons(9, 256, (0.10, 0.10, 0.11), (0.42, 0.41, 0.40)))
    hub = textured(scene_textures.stripes(6, 128, (0.85, 0.85, 0.83), (0.30, 0.31, 0.34)))
    cap = plain((0.80, 0.20, 0.05), shine=0.1)
    steel = plain(_METAL, shine=0.2)
    parts: dict[str, Node] = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        inner, outer = sign * 0.33, sign * 0.46
        for k, x in enumerate((-0.46, 0.0, 0.46)):
            name = f"wheel_{side}_{k}"
            parts[name] = tube((x, inner, 0.16), (x, outer, 0.16), 0.16, tread)
            for face, y in (("inner", inner), ("outer", outer)):
                parts[f"{name}_{face}"] = disc(place((x, y, 0.16), roll_deg=90.0), 0.16, hub)
            parts[f"{name}_cap"] = ball(place((x, outer, 0.16)), 0.045, cap)
        hinge = (0.12, sign * 0.29, 0.46)
        for k, x in enumerate((-0.46, 0.0, 0.46)):
            parts[f"rocker_{side}_{k}"] = tube(hinge, (x, sign * 0.32, 0.16), 0.025, steel)
        parts[f"hinge_{side}"] = ball(place(hinge), 0.05, cap)
    return parts


def _solar_wings(rng: np.random.Generator) -> dict[str, Node]:
    cells = textured(scene_textures.solar_cells(4, 6, 480, rng), shine=0.15)
    frame = plain((0.75, 0.76, 0.78))
    parts: dict[str, Node] = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        T = place((-0.10, sign * 0.47, 0.66), roll_deg=sign * 22)
        parts[f"wing_{side}"] = box(T, (0.60, 0.42, 0.02), frame)
        parts[f"wing_{side}_cells"] = panel(T @ place((0.0, 0.0, 0.0105)), (0.57, 0.39), cells)
    return parts


def _mast() -> dict[str, Node]:
    banded = textured(scene_textures.stripes(5, 128, (0.92, 0.90, 0.86), (0.15, 0.32, 0.62)))
    head = textured(scene_textures.stripes(3, 128, (0.95, 0.93, 0.88), (0.93, 0.55, 0.10)))
    lens, iris = plain(_DARK, shine=0.05), plain((0.05, 0.45, 0.70), shine=0.05)
    x, y = 0.34, 0.12
    T_head = place((x + 0.02, y, 1.06), yaw_deg=18.0, pitch_deg=12.0)
    parts = {
        "mast": tube((x, y, 0.55), (x, y, 1.02), 0.035, banded),
        "mast_foot": disc(place((x, y, 0.56)), 0.08, plain(_METAL)),
        "head": box(T_head, (0.14, 0.32, 0.15), head),
    }
    for name, side in (("left", 0.085), ("right", -0.085)):
        begin, end = (se3.transform(T_head, np.array([x, side, 0.0])) for x in (0.06, 0.12))
        parts[f"lens_{name}"] = tube(begin, end, 0.06, lens)
        parts[f"iris_{name}"] = disc(T_head @ place((0.119, side, 0.0), pitch_deg=90.0), 0.06, iris)
        parts[f"pupil_{name}"] = ball(T_head @ place((0.105, side, 0.0)), 0.032, lens)
    return parts


def _dish() -> dict[str, Node]:
    rings = textured(scene_textures.stripes(5, 256, (0.95, 0.95, 0.93), (0.80, 0.24, 0.16)))
    T = place((-0.24, -0.10, 0.84), yaw_deg=-60.0, pitch_deg=50.0)
    centre, feed = T[:3, 3], se3.transform(T, np.array([0.0, 0.0, 0.15]))
    steel = plain(_METAL, shine=0.2)
    return {
        "dish": disc(T, 0.20, rings),
        "dish_stem": tube((-0.24, -0.10, 0.55), centre, 0.02, steel),
        "dish_boom": tube(centre, feed, 0.01, steel),
        "dish_feed": ball(place(feed), 0.03, plain((0.9, 0.7, 0.1), shine=0.1)),
    }


def _stern() -> dict[str, Node]:
    fins = textured(scene_textures.stripes(9, 256, (0.20, 0.20, 0.22), (0.62, 0.60, 0.58)), repeat=(4.0, 1.0))
    whip = plain((0.90, 0.88, 0.84))
    return {
        "generator": tube((-0.46, 0.0, 0.50), (-0.66, 0.0, 0.62), 0.09, fins),
        "generator_end": ball(place((-0.66, 0.0, 0.62)), 0.09, plain((0.30, 0.30, 0.33))),
        "whip": tube((-0.36, 0.17, 0.55), (-0.40, 0.19, 1.16), 0.009, whip),
        "whip_ball": ball(place((-0.40, 0.19, 1.18)), 0.045, plain((0.95, 0.30, 0.03), shine=0.1)),
    }
