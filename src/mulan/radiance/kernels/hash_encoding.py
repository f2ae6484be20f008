"""Multiresolution hash encoding: a readable reference and the tuned torch path, one table layout for both.

The table is ``[levels, entries, features]`` float32. A point p in [0, 1]³ lies in cell ``floor(p·R)`` of a
level with R cells a side, and its encoding is the trilinear blend of the cell's 8 corners. Corner (x, y, z)
is entry ``x + y·(R+1) + z·(R+1)²`` of a dense level and ``(x ^ y·2654435761 ^ z·805459861) & (entries-1)``
of a hashed one (Müller et al. 2022, eq. 4); products are taken modulo 2³².
"""

from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float, Int, Shaped
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional

from mulan.radiance.config import FieldConfig

PRIME_Y, PRIME_Z = 2654435761, 805459861


def corner_index(
    corner: Int[Tensor, "*b 3"], resolution: int, is_dense: bool, entries: int
) -> Int[Tensor, "*b"]:
    """Table entry of grid corners of one level (reference form, int64)."""
    x, y, z = corner[..., 0], corner[..., 1], corner[..., 2]
    if is_dense:
        side = resolution + 1
        return x + y * side + z * side * side
    # The mask keeps the low bits only, on which int64 and uint32 products agree.
    return (x ^ (y * PRIME_Y) ^ (z * PRIME_Z)) & (entries - 1)


def encode_reference(
    points: Float[Tensor, "n 3"], table: Float[Tensor, "levels entries features"], config: FieldConfig
) -> Float[Tensor, "n encoded"]:
    """Encoding of unit-cube points, one level and one corner at a time; differentiable in both arguments.

    Returns:
        ``[n, levels·features]``, level-major.
    """
    encoded = []
    for level in range(config.levels):
        resolution = config.level_resolution(level)
        scaled = points * resolution
        cell = scaled.detach().floor().long().clamp(0, resolution - 1)
        fraction = scaled - cell
        total = torch.zeros(len(points), config.features, dtype=table.dtype)
        for corner in range(8):
            offset = torch.tensor([corner & 1, (corner >> 1) & 1, corner >> 2])
            weight = torch.where(offset.bool(), fraction, 1 - fraction).prod(-1)
            entry = corner_index(cell + offset, resolution, config.level_is_dense(level), table.shape[1])
            total = total + weight[:, None] * table[level, entry]
        encoded.append(total)
    return torch.cat(encoded, -1)


class HashEncoding:
    """The tuned torch path: all levels at once, gather by ``embedding_bag``, scatter by ``bincount``."""

    def __init__(self, config: FieldConfig) -> None:
        self.config = config
        resolutions = [config.level_resolution(level) for level in range(config.levels)]
        dense = [config.level_is_dense(level) for level in range(config.levels)]
        # Resolutions grow, so the dense levels come first and the two kinds need one operation each.
        self._dense_levels = sum(dense)
        strides = [
            (1, r + 1, (r + 1) ** 2) if d else (1, _as_int32(PRIME_Y), PRIME_Z)
            for r, d in zip(resolutions, dense, strict=True)
        ]
        self._resolution = torch.tensor(resolutions, dtype=torch.int32)
        self._strides = torch.tensor(strides, dtype=torch.int32).T[:, :, None]  # [axis, level, 1]

    def __call__(
        self, points: Float[Tensor, "n 3"], table: Float[Tensor, "levels entries features"]
    ) -> Float[Tensor, "n encoded"]:
        """Same values and gradients as :func:`encode_reference`."""
        index, fraction = self.locate(points, table.shape[1])
        return _Encode.apply(points, table, index, fraction, self._resolution)  # type: ignore[no-any-return]

    def locate(
        self, points: Float[Tensor, "n 3"], entries: int
    ) -> tuple[Int[Tensor, "levels n 8"], Float[Tensor, "3 levels n"]]:
        """Flat table rows of the 8 corners of every point's cells, x outermost, and its place in them."""
        with torch.no_grad():
            resolution = self._resolution.to(points.dtype)[:, None]
            last_cell = (self._resolution - 1)[:, None]
            cells, fractions = [], []
            for axis in range(3):
                scaled = resolution * points[:, axis]
                cell = torch.minimum(scaled.to(torch.int32).clamp_min_(0), last_cell)
                cells.append(cell)
                fractions.append(scaled - cell)
            sides = [torch.stack([cell, cell + 1]) * s for cell, s in zip(cells, self._strides, strict=True)]
            d = self._dense_levels
            dense = _corners([side[:, :d] for side in sides], torch.add)
            hashed = _corners([side[:, d:] for side in sides], torch.bitwise_xor) & (entries - 1)
            index = torch.cat([dense, hashed])
            index += (torch.arange(self.config.levels, dtype=torch.int32) * entries)[:, None, None]
            return index, torch.stack(fractions)


class _Encode(torch.autograd.Function):
    """Blend of the located corners with hand-written gradients."""

    @staticmethod
    def forward(ctx, points, table, index, fraction, resolution):  # type: ignore[override]  # noqa: ARG004
        levels, n, _ = index.shape
        weight = _corners([_pair(f) for f in fraction], torch.mul)
        rows = table.reshape(-1, table.shape[-1])
        encoded = functional.embedding_bag(
            index.view(-1, 8), rows, mode="sum", per_sample_weights=weight.view(-1, 8)
        ).view(levels, n, table.shape[-1])
        ctx.save_for_backward(table, index, fraction, resolution, weight)
        return encoded.transpose(0, 1).flatten(1)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad_encoded):  # type: ignore[override]
        table, index, fraction, resolution, weight = ctx.saved_tensors
        levels, n, _ = index.shape
        entries, features = table.shape[1:]
        grad = grad_encoded.view(n, levels, features).transpose(0, 1).contiguous()
        grad_points = grad_table = None
        if ctx.needs_input_grad[1]:
            flat = index.view(-1)
            parts = [
                torch.bincount(
                    flat, weights=(grad[..., f, None] * weight).view(-1), minlength=levels * entries
                )
                for f in range(features)
            ]
            grad_table = torch.stack(parts, -1).to(table.dtype).view_as(table)
        if ctx.needs_input_grad[0]:
            corners = table.reshape(-1, features)[index.long()]
            slope = (corners * grad[:, :, None]).sum(-1)
            scale = resolution.to(fraction.dtype)[:, None]
            step = torch.tensor([-1.0, 1.0], dtype=fraction.dtype)[:, None, None].expand(2, levels, n)
            parts = []
            for axis in range(3):
                sides = [step if other == axis else _pair(fraction[other]) for other in range(3)]
                parts.append((slope * _corners(sides, torch.mul)).sum(-1).mul(scale).sum(0))
            grad_points = torch.stack(parts, -1)
        return grad_points, grad_table, None, None, None


def _pair(fraction: Float[Tensor, "levels n"]) -> Float[Tensor, "2 levels n"]:
    return torch.stack([1 - fraction, fraction])


def _corners(
    sides: Sequence[Shaped[Tensor, "2 levels n"]],
    combine: Callable[[Tensor, Tensor], Tensor],
) -> Shaped[Tensor, "levels n 8"]:
    """All 8 combinations, x outermost; stacked last, as inner loops over 2 elements are 10 times slower."""
    x, y, z = sides
    combined = combine(combine(x[:, None], y[None])[:, :, None], z[None, None])
    return torch.stack(list(combined.flatten(0, 2)), -1)


def _as_int32(value: int) -> int:
    return value - 2**32 if value >= 2**31 else value
