"""Small fields and rays for the tests, and the structures that the library reads."""

import ctypes
from dataclasses import dataclass

import torch
from torch import Tensor

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.native_buffers import address, native_field, native_scene
from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import NativeOccupancy, NativeRays
from mulan.radiance.space import SceneSpace

# 2 dense levels and 3 hashed ones; sizes that fill no vector evenly
FIELD = FieldConfig(
    levels=5,
    log2_table_size=9,
    base_resolution=4,
    finest_resolution=40,
    width=24,
    geometry_features=7,
    harmonics_degree=4,
)


def random_table(generator: torch.Generator, config: FieldConfig = FIELD) -> Tensor:
    return torch.rand(config.levels, 2**config.log2_table_size, 2, generator=generator) * 2 - 1


def random_networks(
    generator: torch.Generator, library: NativeLibrary, config: FieldConfig = FIELD
) -> Tensor:
    count = library.functions.mulan_network_parameters(native_field(config))
    return (torch.rand(count, generator=generator) * 2 - 1) * 0.5


def unit_vectors(n: int, generator: torch.Generator) -> Tensor:
    return torch.nn.functional.normalize(torch.randn(n, 3, generator=generator), dim=-1)


def rays_towards(n: int, distance: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Rays from a sphere about the origin to points near the origin."""
    origins = unit_vectors(n, generator) * distance
    targets = (torch.rand(n, 3, generator=generator) * 2 - 1) * 0.8
    return origins, torch.nn.functional.normalize(targets - origins, dim=-1)


@dataclass
class Grid:
    """Occupied cells [cascade, z, y, x] and what the library makes of them."""

    cells: Tensor
    words: Tensor
    native: NativeOccupancy


def pack(library: NativeLibrary, cells: Tensor) -> Grid:
    """A grid of cells [cascade, z, y, x], or [z, y, x] for a single one."""
    cells = cells if cells.dim() == 4 else cells[None]
    cascades, side = cells.shape[:2]
    words = torch.zeros(cascades * (side // 4) ** 3, dtype=torch.int64)
    native = NativeOccupancy(words=address(words))
    check(
        library.functions.mulan_occupancy_pack(
            side,
            cascades,
            address(cells),
            native.words,
            ctypes.addressof(native.lower),
            ctypes.addressof(native.upper),
        )
    )
    return Grid(cells, words, native)


def native_rays(origins: Tensor, directions: Tensor, seed: int | None = None) -> NativeRays:
    return NativeRays(len(origins), address(origins), address(directions), seed or 0, seed is not None)


def march(
    library: NativeLibrary, config: MarchConfig, space: SceneSpace, grid: Grid, o: Tensor, d: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Counts [r], distances and steps [r, steps] of rays' samples, mid-step."""
    scene, rays = native_scene(config, space, True), native_rays(o, d)
    count = torch.zeros(len(o), dtype=torch.int32)
    t, dt = torch.zeros(2, len(o), scene.steps).unbind(0)
    check(
        library.functions.mulan_march(
            scene, grid.native, rays, scene.steps, address(count), address(t), address(dt)
        )
    )
    return count, t, dt
