from collections import Counter
from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

from mulan.errors import InputError
from mulan.simulation.mitsuba_parts import ball, box, disc, panel, place, plain, tube, use_scalar_variant
from mulan.simulation.radio_material import RadioMaterial, radio_material
from mulan.simulation.radio_surfaces import radio_surfaces
from mulan.simulation.scene import SceneConfig, assemble
from mulan.simulation.world import build_world
from mulan.simulation.world_kind import WorldKind

UNMERGED = replace(SceneConfig(), merge_meshes=False)
WHITE = plain((0.8, 0.8, 0.8))


def _surfaces(**parts):
    return {surface.name.partition("_")[2]: surface for surface in radio_surfaces(assemble(parts, UNMERGED))}


def _area_m2(surface):
    a, b, c = surface.vertices_m[surface.triangles].swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


@pytest.mark.parametrize(
    ("names", "surface", "material"),
    [
        (("mat-itu_metal", "crate"), "SmoothDiffuse", RadioMaterial.METAL),
        (("bsdf", "crate_2"), "SmoothDiffuse", RadioMaterial.WOOD),
        (("bsdf", "window_left"), "SmoothDiffuse", RadioMaterial.GLASS),
        (("bsdf", "shed_door"), "SmoothDiffuse", RadioMaterial.WOOD),
        (("", "thing"), "TwoSided[ RoughConductor[]]", RadioMaterial.METAL),
        (("", "thing"), "ThinDielectric[]", RadioMaterial.GLASS),
        (("bsdf", "wall_north"), "SmoothDiffuse", RadioMaterial.CONCRETE),
        (("bsdf", "leaf_3"), "SmoothDiffuse", None),
    ],
)
def test_names_say_what_a_thing_is_made_of(names, surface, material):
    assert radio_material(names, surface) is material


def test_faces_keep_the_size_and_place_of_mitsubas_shapes():
    T = place((1.0, 2.0, 3.0), yaw_deg=30.0)
    found = _surfaces(
        a=box(T, (0.4, 0.6, 0.8), WHITE),
        b=panel(T, (0.5, 0.7), WHITE),
        c=disc(T, 0.3, WHITE),
        d=tube((0.0, 0.0, 0.0), (0.0, 0.0, 2.0), 0.3, WHITE),
        e=ball(T, 0.5, WHITE),
    )
    assert _area_m2(found["a"]) == pytest.approx(2 * (0.4 * 0.6 + 0.4 * 0.8 + 0.6 * 0.8), rel=1e-5)
    assert _area_m2(found["b"]) == pytest.approx(0.35, rel=1e-5)
    assert _area_m2(found["c"]) == pytest.approx(np.pi * 0.3**2, rel=1e-5)
    assert _area_m2(found["d"]) == pytest.approx(2 * np.pi * 0.3 * 2.0, rel=0.05)
    assert np.allclose(np.linalg.norm(found["e"].vertices_m - [1.0, 2.0, 3.0], axis=1), 0.5, atol=1e-5)
    for name in ("a", "b", "c", "e"):
        assert np.allclose(found[name].vertices_m.mean(0), [1.0, 2.0, 3.0], atol=1e-5)
    assert np.allclose(found["d"].vertices_m.mean(0), [0.0, 0.0, 1.0], atol=1e-5)


def test_thin_and_shining_things_are_left_out():
    shining = panel(place((0.0, 0.0, 2.0)), (1.0, 1.0), WHITE)
    shining["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
    whip = tube((0.0, 0.0, 0.0), (0.2, 0.1, 1.0), 0.02, WHITE)
    floor = panel(place((0.0, 0.0, 0.0)), (4.0, 4.0), WHITE)
    assert set(_surfaces(lamp=shining, whip=whip, ground=floor)) == {"ground"}


def test_built_in_worlds_have_walls_wooden_things_and_unique_names():
    for kind in (WorldKind.ROOM, WorldKind.CORRIDOR):
        surfaces = radio_surfaces(build_world(kind, UNMERGED).scene)
        assert len({surface.name for surface in surfaces}) == len(surfaces)
        made_of = Counter(surface.material for surface in surfaces)
        assert made_of[RadioMaterial.CONCRETE] >= 6
        assert made_of[RadioMaterial.WOOD] >= 4


def test_a_shape_without_faces_is_refused_in_one_sentence():
    use_scalar_variant()
    grid = mi.TensorXf(np.indices((3, 3, 3)).sum(0)[..., None].astype(np.float32) - 2.5)
    scene = mi.load_dict({"type": "scene", "blob": {"type": "sdfgrid", "grid": grid}})
    with pytest.raises(InputError, match=r"blob.*is a SDFGrid.*save it as a mesh"):
        radio_surfaces(scene)
