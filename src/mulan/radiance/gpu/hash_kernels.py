"""Hash encoding (reference: ``kernels/hash_encoding.py``): one program looks at one level of some points.

Encodings are kept feature by feature, ``[levels·features, room]``, so that neighbouring points lie side by
side. All programs of a level run before those of the next: a level's table stays in the cache.
"""

from typing import no_type_check

import torch
import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor

from mulan.radiance.config import FieldConfig
from mulan.radiance.gpu.launch import TritonConfig, programs
from mulan.radiance.kernels.hash_encoding import PRIME_Y, PRIME_Z


@triton.jit
@no_type_check
def corner_rows(x, y, z, resolution, dense, entries, PRIME_Y: tl.constexpr, PRIME_Z: tl.constexpr):
    """Table row of grid corners within their level."""
    side = resolution + 1
    ordered = x + (y + z * side) * side
    ux, uy, uz = x.to(tl.uint32), y.to(tl.uint32), z.to(tl.uint32)
    hashed = (ux ^ (uy * PRIME_Y) ^ (uz * PRIME_Z)).to(tl.int32) & (entries - 1)
    return tl.where(dense != 0, ordered, hashed)


@triton.jit
@no_type_check
def cell_and_place(coordinate, resolution):
    """Cell of a coordinate in [0, 1] and the place in it."""
    scaled = coordinate * resolution
    cell = tl.minimum(tl.maximum(scaled, 0.0), resolution - 1.0).to(tl.int32)
    return cell, scaled - cell


@triton.jit(do_not_specialize=["n"])
@no_type_check
def encode_kernel(
    unit,
    table,
    level_resolution,
    level_dense,
    level_weight,
    encoded,
    n,
    room,
    entries,
    PRIME_Y: tl.constexpr,
    PRIME_Z: tl.constexpr,
    F: tl.constexpr,
    B: tl.constexpr,
):
    """Trilinear blend of the 8 corners of every point's cell in one level."""
    level = tl.program_id(1)
    i = tl.program_id(0) * B + tl.arange(0, B)
    on = i < n
    resolution, dense = tl.load(level_resolution + level), tl.load(level_dense + level)
    cx, fx = cell_and_place(tl.load(unit + i, mask=on, other=0.0), resolution)
    cy, fy = cell_and_place(tl.load(unit + room + i, mask=on, other=0.0), resolution)
    cz, fz = cell_and_place(tl.load(unit + 2 * room + i, mask=on, other=0.0), resolution)
    feature = tl.arange(0, F)
    total = tl.zeros([B, F], tl.float32)
    for corner in tl.static_range(8):
        dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (fx if dx else 1 - fx) * (fy if dy else 1 - fy) * (fz if dz else 1 - fz)
        row = level * entries + corner_rows(
            cx + dx, cy + dy, cz + dz, resolution, dense, entries, PRIME_Y, PRIME_Z
        )
        values = tl.load(table + row[:, None] * F + feature[None, :], mask=on[:, None], other=0.0)
        total += weight[:, None] * values
    at = (level * F + feature)[None, :] * room + i[:, None]
    tl.store(encoded + at, total * tl.load(level_weight + level), mask=on[:, None])


@triton.jit
@no_type_check
def scatter_kernel(
    unit,
    gradient,
    count,
    level_resolution,
    level_dense,
    level_weight,
    table_gradient,
    room,
    entries,
    PRIME_Y: tl.constexpr,
    PRIME_Z: tl.constexpr,
    F: tl.constexpr,
    B: tl.constexpr,
):
    """Adds the gradient to the table from the gradient to the encoding; levels of weight 0 get none."""
    level = tl.program_id(1)
    first, n = tl.program_id(0) * B, tl.load(count)
    scale = tl.load(level_weight + level)
    if first >= n:
        return
    if scale == 0:
        return
    i = first + tl.arange(0, B)
    on = i < n
    resolution, dense = tl.load(level_resolution + level), tl.load(level_dense + level)
    cx, fx = cell_and_place(tl.load(unit + i, mask=on, other=0.0), resolution)
    cy, fy = cell_and_place(tl.load(unit + room + i, mask=on, other=0.0), resolution)
    cz, fz = cell_and_place(tl.load(unit + 2 * room + i, mask=on, other=0.0), resolution)
    feature = tl.arange(0, F)
    at = (level * F + feature)[None, :] * room + i[:, None]
    upstream = tl.load(gradient + at, mask=on[:, None], other=0.0) * scale
    for corner in tl.static_range(8):
        dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (fx if dx else 1 - fx) * (fy if dy else 1 - fy) * (fz if dz else 1 - fz)
        row = level * entries + corner_rows(
            cx + dx, cy + dy, cz + dz, resolution, dense, entries, PRIME_Y, PRIME_Z
        )
        to = table_gradient + row[:, None] * F + feature[None, :]
        tl.atomic_add(to, weight[:, None] * upstream, mask=on[:, None], sem="relaxed")


@triton.jit
@no_type_check
def point_gradient_kernel(
    unit,
    table,
    gradient,
    count,
    level_resolution,
    level_dense,
    level_weight,
    point_gradient,
    room,
    entries,
    levels,
    PRIME_Y: tl.constexpr,
    PRIME_Z: tl.constexpr,
    F: tl.constexpr,
    B: tl.constexpr,
):
    """Gradient to the points from the gradient to their encoding, over all levels."""
    first, n = tl.program_id(0) * B, tl.load(count)
    if first >= n:
        return
    i = first + tl.arange(0, B)
    on = i < n
    x = tl.load(unit + i, mask=on, other=0.0)
    y = tl.load(unit + room + i, mask=on, other=0.0)
    z = tl.load(unit + 2 * room + i, mask=on, other=0.0)
    feature = tl.arange(0, F)
    gx = tl.zeros([B], tl.float32)
    gy = gx
    gz = gx
    for level in range(levels):
        resolution, dense = tl.load(level_resolution + level), tl.load(level_dense + level)
        scale = tl.load(level_weight + level) * resolution
        cx, fx = cell_and_place(x, resolution)
        cy, fy = cell_and_place(y, resolution)
        cz, fz = cell_and_place(z, resolution)
        at = (level * F + feature)[None, :] * room + i[:, None]
        upstream = tl.load(gradient + at, mask=on[:, None], other=0.0) * scale
        for corner in tl.static_range(8):
            dx, dy, dz = corner & 1, (corner >> 1) & 1, corner >> 2
            wx, wy, wz = fx if dx else 1 - fx, fy if dy else 1 - fy, fz if dz else 1 - fz
            row = level * entries + corner_rows(
                cx + dx, cy + dy, cz + dz, resolution, dense, entries, PRIME_Y, PRIME_Z
            )
            values = tl.load(table + row[:, None] * F + feature[None, :], mask=on[:, None], other=0.0)
            slope = tl.sum(values * upstream, 1)
            gx += slope * wy * wz * (2 * dx - 1)
            gy += slope * wx * wz * (2 * dy - 1)
            gz += slope * wx * wy * (2 * dz - 1)
    tl.store(point_gradient + i, gx, mask=on)
    tl.store(point_gradient + room + i, gy, mask=on)
    tl.store(point_gradient + 2 * room + i, gz, mask=on)


class GpuEncoding:
    """The encoding and its gradients; points beyond the count are left alone.

    Attributes:
        level_weight: Scale of each level's features; a level of weight 0 neither acts nor learns.
    """

    def __init__(self, field: FieldConfig, config: TritonConfig, device: torch.device) -> None:
        levels = range(field.levels)
        self._field, self._config = field, config
        self._resolution = torch.tensor([field.level_resolution(i) for i in levels], dtype=torch.int32).to(
            device
        )
        self._dense = torch.tensor([field.level_is_dense(i) for i in levels], dtype=torch.int32).to(device)
        self.level_weight = torch.ones(field.levels, device=device)

    def encode(
        self, unit: Float[Tensor, "3 room"], table: Float[Tensor, "levels entries features"], count: int
    ) -> Float[Tensor, "encoded room"]:
        """Encodings of the first ``count`` points."""
        room = unit.shape[1]
        shape = (self._field.encoded_width, room)
        encoded = torch.empty(shape, dtype=self._config.precision.storage, device=unit.device)
        if count:
            encode_kernel[self._grid(count)](
                *(unit, table, *self._levels, encoded, count, room, table.shape[1], *self._constants)
            )
        return encoded

    def scatter(
        self,
        unit: Float[Tensor, "3 room"],
        gradient: Float[Tensor, "encoded room"],
        count: Tensor,
        table_gradient: Float[Tensor, "levels entries features"],
    ) -> None:
        """Add to the table's gradient; the count lies on the device. The order of the sums is not fixed."""
        room, entries = unit.shape[1], table_gradient.shape[1]
        scatter_kernel[self._grid(room)](
            *(unit, gradient, count, *self._levels, table_gradient, room, entries, *self._constants)
        )

    def point_gradients(
        self,
        unit: Float[Tensor, "3 room"],
        table: Float[Tensor, "levels entries features"],
        gradient: Float[Tensor, "encoded room"],
        count: Tensor,
    ) -> Float[Tensor, "3 room"]:
        """Gradient to the points; the count lies on the device."""
        room, out = unit.shape[1], torch.empty_like(unit)
        point_gradient_kernel[self._grid(room)[:1]](
            *(unit, table, gradient, count, *self._levels, out, room, table.shape[1], self._field.levels),
            *self._constants,
        )
        return out

    @property
    def _levels(self) -> tuple[Tensor, Tensor, Tensor]:
        return self._resolution, self._dense, self.level_weight

    @property
    def _constants(self) -> tuple[int, int, int, int]:
        return PRIME_Y, PRIME_Z, self._field.features, self._config.blocks.samples

    def _grid(self, points: int) -> tuple[int, int]:
        return programs(points, self._config.blocks.samples), self._field.levels
