"""Where the cameras of a world go and what they look at."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from mulan.geometry import se3

_OVERLAP = 1.4  # each robot sees 40 % more than its share
_SPACING_M = 0.05  # between the points a way is kept as
_CORNER_M = 0.35  # over which corners are rounded


def look_at(eye_m: Float[NDArray, "n 3"], target_m: Float[NDArray, "n 3"]) -> Float[NDArray, "n 4 4"]:
    """Upright camera poses (OpenGL axes, world z up) from eye points towards targets."""
    back = eye_m - target_m
    back = back / np.linalg.norm(back, axis=1, keepdims=True)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right, axis=1, keepdims=True)
    return se3.from_parts(np.stack([right, np.cross(back, right), back], -1), eye_m)


class Course(ABC):
    """A band of space, one end to the other, that is free of obstacles and worth photographing from."""

    has_centre: ClassVar[bool]
    """Whether there is a point all its cameras look at."""

    @abstractmethod
    def cameras(
        self,
        along: Float[NDArray, "n"],
        outward: Float[NDArray, "n"],
        upward: Float[NDArray, "n"],
        sway_m: Float[NDArray, "n 3"],
    ) -> Float[NDArray, "n 4 4"]:
        """Camera poses (OpenGL axes).

        Args:
            along: Place on the course, 0 its beginning and 1 its end.
            outward: Place across it, 0..1.
            upward: Height, 0 the lowest and 1 the highest.
            sway_m: Added to the points looked at.
        """

    @abstractmethod
    def share(self, robot: int, robots: int, fraction: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """Places along the course of one of several robots, from 0 to 1 of its share; shares overlap."""


@dataclass(frozen=True)
class RingCourse(Course):
    """Around the vertical axis through the world's origin, looking at it.

    Attributes:
        radius_m: Nearest and farthest distance.
        height_m: Lowest and highest camera.
        target_height_m: Height that cameras look at.
    """

    has_centre: ClassVar[bool] = True
    radius_m: tuple[float, float]
    height_m: tuple[float, float]
    target_height_m: float

    def cameras(
        self,
        along: Float[NDArray, "n"],
        outward: Float[NDArray, "n"],
        upward: Float[NDArray, "n"],
        sway_m: Float[NDArray, "n 3"],
    ) -> Float[NDArray, "n 4 4"]:
        """See :class:`Course`; one turn is the whole course."""
        radius = self.radius_m[0] + outward * (self.radius_m[1] - self.radius_m[0])
        height = self.height_m[0] + upward * (self.height_m[1] - self.height_m[0])
        azimuth_rad = 2 * np.pi * along
        eye = np.stack([radius * np.cos(azimuth_rad), radius * np.sin(azimuth_rad), height], -1)
        return look_at(eye, np.array([0.0, 0.0, self.target_height_m]) + sway_m)

    def share(self, robot: int, robots: int, fraction: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """A sector about the robot's own azimuth."""
        return robot / robots + (fraction - 0.5) * min(_OVERLAP / robots, 1.0)


@dataclass(frozen=True)
class WayCourse(Course):
    """Along a way with corners, looking ahead.

    Attributes:
        corners_m: The way's ends and corners on the floor.
        half_width_m: How far to either side cameras may be.
        height_m: Lowest and highest camera.
        ahead_m: Distance along the way of the point looked at.
        target_height_m: Its height.
    """

    has_centre: ClassVar[bool] = False
    corners_m: tuple[tuple[float, float], ...]
    half_width_m: float
    height_m: tuple[float, float]
    ahead_m: float
    target_height_m: float

    def cameras(
        self,
        along: Float[NDArray, "n"],
        outward: Float[NDArray, "n"],
        upward: Float[NDArray, "n"],
        sway_m: Float[NDArray, "n 3"],
    ) -> Float[NDArray, "n 4 4"]:
        """See :class:`Course`; ``outward`` is from the right of the way to its left."""
        place_m, length_m = self._rounded()
        at_m = np.clip(along, 0.0, 1.0) * length_m[-1]
        step = np.gradient(place_m, axis=0)
        left = np.stack([-step[:, 1], step[:, 0]], -1) / np.linalg.norm(step, axis=1, keepdims=True)
        aside = (2 * outward - 1) * self.half_width_m
        ground = _on(length_m, place_m, at_m) + aside[:, None] * _on(length_m, left, at_m)
        height = self.height_m[0] + upward * (self.height_m[1] - self.height_m[0])
        beyond_m = np.clip(at_m + self.ahead_m - length_m[-1], 0.0, None)
        end = step[-1] / np.linalg.norm(step[-1])
        ahead = _on(length_m, place_m, at_m + self.ahead_m) + beyond_m[:, None] * end
        target = np.column_stack([ahead, np.full(len(at_m), self.target_height_m)])
        return look_at(np.column_stack([ground, height]), target + sway_m)

    def share(self, robot: int, robots: int, fraction: Float[NDArray, "n"]) -> Float[NDArray, "n"]:
        """A stretch of the way; robots come one after another along it."""
        length = min(_OVERLAP / robots, 1.0)
        begin = 0.0 if robots == 1 else robot / (robots - 1) * (1 - length)
        return begin + fraction * length

    def _rounded(self) -> tuple[Float[NDArray, "p 2"], Float[NDArray, "p"]]:
        """Points of the way with its corners rounded, and the length up to each."""
        corners = np.array(self.corners_m)
        legs_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
        points = _on(legs_m, corners, np.arange(0.0, legs_m[-1] + 1e-9, _SPACING_M))
        points = gaussian_filter1d(points, _CORNER_M / _SPACING_M, axis=0, mode="nearest")
        return points, np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _on(
    length_m: Float[NDArray, "p"], values: Float[NDArray, "p k"], at_m: Float[NDArray, "n"]
) -> Float[NDArray, "n k"]:
    return np.stack([np.interp(at_m, length_m, column) for column in values.T], -1)
