"""Places a robot can drive or fly to round what the field knows to be matter."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from mulan.radiance.engine import RadianceEngine

_FINER = 3  # points across a cell at which matter is looked for, or thin walls would lie between them


@dataclass(frozen=True)
class FreeSpaceConfig:
    """Candidates beyond the ring."""

    reach_m: float = 2.0
    """Longest way to a candidate."""
    spacing_m: float = 0.15
    """Distance between neighbouring places looked at."""
    in_the_air: bool = False
    """Whether the robot can change its height; else all places are at its own."""
    places: int = 64
    """Candidates to keep, spread evenly over what can be reached."""
    max_density_per_m: float = 5.0
    """Matter is where the field's density exceeds this."""
    clearance_m: float = 0.15
    """Distance to keep from matter."""


@dataclass(frozen=True)
class ReachablePlaces:
    """Places with the shortest way to each.

    Attributes:
        position_m: Where they are.
        travel_m: Length of the way, round what is in between.
    """

    position_m: Float[NDArray, "n 3"]
    travel_m: Float[NDArray, "n"]


def reachable_places(
    engine: RadianceEngine, start_m: Float[NDArray, "3"], config: FreeSpaceConfig
) -> ReachablePlaces:
    """Places reachable from where a robot stands, found on a grid about it (Dijkstra, 8 or 26 neighbours).

    The robot's own cell counts as free, so that one that stands too near to something can leave. Matter is
    looked for three times as finely as places; ways between places keep clear of it as long as
    ``spacing_m`` does not exceed the clearance much.
    """
    side = int(config.reach_m / config.spacing_m)
    steps = np.arange(-side, side + 1)
    heights = steps if config.in_the_air else np.zeros(1)
    offset = np.stack(np.meshgrid(steps, steps, heights, indexing="ij"), -1) * config.spacing_m
    free = _free(engine, start_m, offset, config)
    length_m = _ways(free, config.spacing_m, (side, side, len(heights) // 2))
    reached = np.isfinite(length_m) & (length_m <= config.reach_m) & (length_m > 0)
    places, travel_m = start_m + offset[reached], length_m[reached]
    kept = _spread(places, start_m, config.places)
    return ReachablePlaces(places[kept], travel_m[kept])


def _free(
    engine: RadianceEngine,
    start_m: Float[NDArray, "3"],
    offset: Float[NDArray, "x y z 3"],
    config: FreeSpaceConfig,
) -> Bool[NDArray, "x y z"]:
    """Which grid points keep their distance from matter, that above and below included."""
    spacing = config.spacing_m / _FINER
    margin = math.ceil(config.clearance_m / spacing)
    nx, ny, nz = (_FINER * (n - 1) + 1 + 2 * margin for n in offset.shape[:3])
    low = offset[0, 0, 0] - margin * spacing
    index = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij"), -1)
    points = start_m + low + index * spacing
    density = engine.density(torch.tensor(points.reshape(-1, 3), dtype=torch.float32)).cpu().numpy()
    matter = density.reshape(nx, ny, nz) > config.max_density_per_m
    reach = np.arange(-margin, margin + 1) * spacing
    ball = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), -1)
    keep_off = np.linalg.norm(ball, axis=-1) <= config.clearance_m + 1e-9
    near = np.asarray(binary_dilation(matter, keep_off), dtype=bool)
    inner = slice(margin, -margin, _FINER) if margin else slice(None, None, _FINER)
    return ~near[inner, inner, inner]


def _ways(
    free: Bool[NDArray, "x y z"], spacing_m: float, start: tuple[int, int, int]
) -> Float[NDArray, "x y z"]:
    """Length of the shortest way from the start to every cell, infinite where there is none."""
    free = free.copy()
    free[start] = True
    number = np.arange(free.size).reshape(free.shape)
    rows, columns, lengths = [], [], []
    for step in np.ndindex(3, 3, 3):
        by = np.array(step) - 1
        if tuple(by) <= (0, 0, 0):
            continue
        here = tuple(slice(max(0, -b), n - max(0, b)) for b, n in zip(by, free.shape, strict=True))
        there = tuple(slice(max(0, b), n - max(0, -b)) for b, n in zip(by, free.shape, strict=True))
        both = free[here] & free[there]
        rows.append(number[here][both])
        columns.append(number[there][both])
        lengths.append(np.full(int(both.sum()), float(np.linalg.norm(by)) * spacing_m))
    edges = np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))
    graph = coo_matrix(edges, shape=(free.size, free.size)).tocsr()
    return dijkstra(graph, directed=False, indices=number[start]).reshape(free.shape)


def _spread(places: Float[NDArray, "n 3"], start_m: Float[NDArray, "3"], count: int) -> NDArray[np.intp]:
    """Indices of so many places, each the farthest from those before it, the start included."""
    if len(places) <= count:
        return np.arange(len(places))
    nearest = np.linalg.norm(places - start_m, axis=1)
    kept = []
    for _ in range(count):
        kept.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(places - places[kept[-1]], axis=1))
    return np.array(kept)
