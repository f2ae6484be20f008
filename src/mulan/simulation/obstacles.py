"""What a robot would run into: the surfaces of the rendered world itself, by casting rays."""

from itertools import pairwise
from typing import Any

import mitsuba as mi
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

_DIRECTIONS = 64  # 0.09 m apart at a distance of 0.2 m
_SPACING_M = 0.06  # between the points of a way that are tried
_RAY: Any = mi.Ray3f  # its types are those of the vectorised variants
_GOLDEN_RAD = np.pi * (3 - np.sqrt(5.0))


class Obstacles:
    """Free space as the simulator knows it, for any Mitsuba scene.

    Surfaces are felt for along rays in all directions, so one thinner than the gap between neighbouring
    rays (a wire) can be missed where a robot stands, hardly where it drives past.

    Attributes:
        scene: The world.
        clearance_m: Radius of the ball about a robot that must stay free.
    """

    def __init__(self, scene: mi.Scene, clearance_m: float) -> None:
        self.scene, self.clearance_m = scene, clearance_m
        k = np.arange(_DIRECTIONS) + 0.5
        z, azimuth_rad = 1 - 2 * k / _DIRECTIONS, _GOLDEN_RAD * k
        level = np.sqrt(1 - z**2)
        self._directions = np.stack(
            [level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), z], -1
        ).tolist()

    def is_free(self, points_m: Float[NDArray, "n 3"]) -> Bool[NDArray, "n"]:
        """Whether no surface lies within the clearance of each point."""
        return np.array([self._is_clear(point) for point in points_m.tolist()], dtype=bool)

    def is_way_free(self, points_m: Float[NDArray, "n 3"]) -> bool:
        """Whether a robot can move along a polyline: nothing in between, and clear all the way."""
        for start, end in pairwise(points_m):
            if self._is_hit(start.tolist(), (end - start).tolist(), 1.0):
                return False
        length_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_m, axis=0), axis=1))])
        at_m = np.linspace(0.0, length_m[-1], 2 + int(length_m[-1] / _SPACING_M))
        tried = np.stack([np.interp(at_m, length_m, axis) for axis in points_m.T], -1)
        return all(self._is_clear(point) for point in tried.tolist())

    def _is_clear(self, point: list[float]) -> bool:
        return not any(self._is_hit(point, direction, self.clearance_m) for direction in self._directions)

    def _is_hit(self, origin: list[float], direction: list[float], reach: float) -> bool:
        # a ray that starts on the very surface must still meet it
        return bool(self.scene.ray_test(_RAY(origin, direction, reach, 0.0, [])))
