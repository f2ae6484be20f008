"""Fields, scenes, rays and parameters that no one would ask for, as arrays and the library's structures."""

import ctypes
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import NativeField, NativeOccupancy, NativeScene

NOT_FINITE = (np.nan, np.inf, -np.inf)
LARGE_AND_SMALL = (0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e-9, 1.0, -1.0, 3e9, 1e38, -1e38, 3.4028235e38)


def at(x: NDArray) -> int:
    return x.ctypes.data


@dataclass
class Case:
    """One field in one scene; arrays have not one number more than the interface asks for."""

    field: NativeField
    scene: NativeScene
    occupancy: NativeOccupancy
    words: NDArray
    occupied: NDArray
    table: NDArray
    networks: NDArray


def odd_field(rng: np.random.Generator) -> NativeField:
    levels, log2 = int(rng.integers(1, 17)), int(rng.integers(4, 13))
    field = NativeField(
        levels=levels,
        log2_table_size=log2,
        width=int(rng.choice([1, 16, 17, 24, 32, 33, 48, 64])),
        geometry_features=int(rng.integers(1, 18)),
        harmonics_degree=int(rng.integers(1, 5)),
        log_density_offset=float(rng.choice([-1.5, 0.0, 80.0])),
        log_density_max=15,
        variance_floor=1e-4,
    )
    for level in range(levels):
        side = int(rng.choice([1, 2, 3, 7, 16, 500, 1 << 22]))
        field.resolution[level] = side
        field.dense[level] = side < 500 and (side + 1) ** 3 <= 2**log2
        field.level_weight[level] = float(rng.choice([0.0, 1.0, -3.0, 1e30], p=[0.1, 0.8, 0.05, 0.05]))
    return field


def odd_scene(rng: np.random.Generator) -> NativeScene:
    scene = NativeScene(
        radius_m=float(rng.choice([1.0, 0.37, 1e-6, 1e6, 1e-42, 1e37])),
        near_radii=0.02,
        growth=float(rng.choice([4.8, 0.0, 60.0])),
        min_transmittance=float(rng.choice([1e-4, 0.0, 2.0])),
        unbounded=int(rng.integers(2)),
        steps=int(rng.choice([1, 7, 40, 255, 257, 500])),
        occupancy_resolution=int(rng.choice([4, 8, 16, 20, 32])),
        cascades=1,
    )
    if scene.occupancy_resolution % 16 == 0:
        scene.cascades = int(rng.integers(1, 5))
    scene.centre_m[:] = rng.choice([0.0, 0.5, -7.0, 1e30], 3, p=[0.6, 0.2, 0.15, 0.05]).tolist()
    scene.background[:] = [1.0, 0.5, 0.0]
    return scene


def odd_case(rng: np.random.Generator, library: NativeLibrary) -> Case:
    field, scene = odd_field(rng), odd_scene(rng)
    side, cascades = scene.occupancy_resolution, scene.cascades
    occupied = (rng.random(cascades * side**3) < rng.choice([0.0, 0.01, 0.5, 1.0])).astype(np.uint8)
    words = np.zeros(cascades * (side // 4) ** 3, np.uint64)
    occupancy = NativeOccupancy(words=at(words), least_opacity=float(rng.choice([0.0, 0.03])))
    bounds = ctypes.addressof(occupancy.lower), ctypes.addressof(occupancy.upper)
    check(library.functions.mulan_occupancy_pack(side, cascades, at(occupied), at(words), *bounds))
    scale = float(rng.choice([1.0, 1.0, 1e-30, 1e30]))
    table = (scale * rng.normal(size=(field.levels, 2**field.log2_table_size, 2))).astype(np.float32)
    networks = rng.normal(size=library.functions.mulan_network_parameters(field)).astype(np.float32)
    if rng.random() < 0.1:  # a training that has diverged
        table[rng.random(table.shape) < 0.1] = np.nan
        networks[rng.random(networks.shape) < 0.1] = np.inf
    return Case(field, scene, occupancy, words, occupied, table, networks)


def odd_rays(rng: np.random.Generator, scene: NativeScene, n: int) -> tuple[NDArray, NDArray]:
    """Origins and directions [n, 3]: ordinary rays of the scene among ones that are not.

    A third of the numbers of every other ray are infinite, NaN, enormous, tiny or zero; some rays start on
    faces, edges and corners of the box or of a cell, some run along an axis.
    """
    centre, radius = np.array(scene.centre_m[:], np.float32), np.float32(scene.radius_m)
    unit = rng.normal(size=(n, 3)).astype(np.float32) * 2
    snapped = rng.random((n, 3)) < 0.3
    sides = np.float32(scene.occupancy_resolution)
    unit[snapped] = (np.round(unit * sides) / sides)[snapped]
    on_face = rng.random((n, 3)) < 0.2
    unit[on_face] = np.sign(unit)[on_face]
    with np.errstate(over="ignore", invalid="ignore"):
        origins = (centre + radius * unit).astype(np.float32)
        towards = rng.uniform(-1, 1, (n, 3)) - unit
        directions = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32)
    axis = rng.random(n) < 0.2
    directions[axis] = np.eye(3, dtype=np.float32)[rng.integers(0, 3, n)][axis] * np.float32(
        1 - 2 * rng.integers(2)
    )
    values = np.array([*NOT_FINITE, *LARGE_AND_SMALL], np.float32)
    for rays in (origins, directions):
        strange = (rng.random((n, 3)) < 0.35) & (np.arange(n) % 2 == 0)[:, None]
        rays[strange] = rng.choice(values, int(strange.sum()))
    return np.ascontiguousarray(origins), np.ascontiguousarray(directions)
