"""How much nearer a view brings everything seen from all around to something that was photographed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.alignment import point_nearest_to_axes
from mulan.planning.candidates import look_at
from mulan.planning.knowledge import Knowledge
from mulan.planning.scores.direction_coverage import DirectionCoverage
from mulan.planning.view import View


@dataclass(frozen=True)
class SurroundCoverage(DirectionCoverage):
    """As :class:`DirectionCoverage`, of the views from all around what the cameras look at.

    Where a robot sees only a few moves ahead, its candidates stand for nothing but themselves; what the field
    will be asked for are pictures from all sides. They stand on a level ring about the point nearest to all
    cameras' axes, as far from it and as high as the photographs on average.
    """

    sides: int = 24
    """Views on the ring."""

    def _asked_for(self, knowledge: Knowledge, candidates: Sequence[View]) -> Sequence[View]:
        """The ring; the candidates themselves before any view was chosen."""
        if len(knowledge.chosen) < 2:
            return candidates
        camera, exact = candidates[0].camera, np.zeros((6, 6))
        T = surrounding([view.T_world_camera for view in knowledge.chosen], self.sides)
        return [View(camera, pose, exact) for pose in T]


def surrounding(T_world_camera: Sequence[Float[NDArray, "4 4"]], sides: int) -> Float[NDArray, "sides 4 4"]:
    """Camera poses all around what given cameras look at, at their mean distance and height."""
    T = np.stack(T_world_camera)
    centre_m = point_nearest_to_axes(T[:, :3, 3], -T[:, :3, 2])
    offset_m = T[:, :3, 3] - centre_m
    radius_m, height_m = np.linalg.norm(offset_m[:, :2], axis=1).mean(), offset_m[:, 2].mean()
    azimuth_rad = 2 * np.pi * np.arange(sides) / sides
    ring_m = np.stack([np.cos(azimuth_rad), np.sin(azimuth_rad), np.zeros(sides)], -1) * radius_m
    places_m = centre_m + ring_m + [0.0, 0.0, height_m]
    return np.stack([look_at(place, centre_m, np.array([1.0, 0.0, 0.0])) for place in places_m])
