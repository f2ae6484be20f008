"""The field once more, plainly and in double precision, with gradients by torch's autograd."""

import math

import torch
from torch import Tensor

from mulan.radiance.config import FieldConfig

OFFSET, FLOOR = -1.5, 1e-4


def encode(points: Tensor, table: Tensor, config: FieldConfig) -> Tensor:
    features = []
    mask = 2**config.log2_table_size - 1
    for level in range(config.levels):
        R = config.level_resolution(level)
        cell = (points.detach() * R).floor().long().clamp(0, R - 1)
        f = points * R - cell
        total = torch.zeros(len(points), 2, dtype=points.dtype)
        for dx in (0, 1):
            for dy in (0, 1):
                for dz in (0, 1):
                    x, y, z = cell[:, 0] + dx, cell[:, 1] + dy, cell[:, 2] + dz
                    if config.level_is_dense(level):
                        index = x + y * (R + 1) + z * (R + 1) ** 2
                    else:
                        index = (x ^ (y * 2654435761 % 2**32) ^ (z * 805459861 % 2**32)) & mask
                    weight = torch.ones(len(points), dtype=points.dtype)
                    for axis, d in enumerate((dx, dy, dz)):
                        weight = weight * (f[:, axis] if d else 1 - f[:, axis])
                    total = total + weight[:, None] * table[level, index]
        features.append(total)
    return torch.cat(features, -1)


def harmonics(d: Tensor, degree: int) -> Tensor:
    x, y, z = d.unbind(-1)
    s = math.sqrt
    pi = math.pi
    bands = [
        s(1 / (4 * pi)) + 0 * x,
        *(-s(3 / (4 * pi)) * y, s(3 / (4 * pi)) * z, -s(3 / (4 * pi)) * x),
        *(s(15 / (4 * pi)) * x * y, -s(15 / (4 * pi)) * y * z, s(5 / (16 * pi)) * (3 * z * z - 1)),
        *(-s(15 / (4 * pi)) * x * z, s(15 / (16 * pi)) * (x * x - y * y)),
        s(35 / (32 * pi)) * y * (y * y - 3 * x * x),
        s(105 / (4 * pi)) * x * y * z,
        s(21 / (32 * pi)) * y * (1 - 5 * z * z),
        s(7 / (16 * pi)) * z * (5 * z * z - 3),
        s(21 / (32 * pi)) * x * (1 - 5 * z * z),
        s(105 / (16 * pi)) * z * (x * x - y * y),
        s(35 / (32 * pi)) * x * (3 * y * y - x * x),
    ]
    return torch.stack(bands[: degree**2], -1)


def split_networks(flat: Tensor, c: FieldConfig) -> list[Tensor]:
    shapes = [
        (c.width, 2 * c.levels),
        (c.geometry_features, c.width),
        (c.width, c.harmonics_degree**2 + c.geometry_features),
        (c.width, c.width),
        (3, c.width),
        (1, c.width + c.geometry_features),
    ]
    parts = flat.split([a * b for a, b in shapes])
    return [p.view(s) for p, s in zip(parts, shapes, strict=True)]


def networks(
    flat: Tensor, encoded: Tensor, d: Tensor, c: FieldConfig, variance_teaches_trunk: bool = False
) -> tuple[Tensor, Tensor, Tensor]:
    """Log-density (before the offset), colour, colour variance."""
    d0, d1, c0, c1, c2, v = split_networks(flat, c)
    hidden = (encoded @ d0.T).relu()
    geometry = hidden @ d1.T
    h = (torch.cat([harmonics(d, c.harmonics_degree), geometry], -1) @ c0.T).relu()
    colour = ((h @ c1.T).relu() @ c2.T).sigmoid()
    head = torch.cat([hidden, geometry], -1)
    raw = (head if variance_teaches_trunk else head.detach()) @ v.T
    return geometry[:, 0], colour, torch.nn.functional.softplus(raw)[:, 0] + FLOOR


def blend(depth: Tensor, min_transmittance: float) -> Tensor:
    """Compositing weights along the last axis, from optical depths."""
    reach = torch.exp(-(depth.cumsum(-1) - depth))
    return torch.where(reach.detach() > min_transmittance, reach * (1 - torch.exp(-depth)), 0.0)


def to_unit(x: Tensor, radius: float, unbounded: bool) -> Tensor:
    x = x / radius
    if not unbounded:
        return x * 0.5 + 0.5
    norm = x.abs().amax(-1, keepdim=True)
    return torch.where(norm <= 1, x, (2 - 1 / norm) * x / norm) * 0.25 + 0.5


def gradient(leaf: Tensor) -> Tensor:
    """What backward() left in a leaf."""
    assert leaf.grad is not None
    return leaf.grad
