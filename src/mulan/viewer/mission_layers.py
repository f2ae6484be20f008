"""Robots in the scene: paths, true paths, 95 % ellipsoids and bearings, up to a moment of the mission."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray
from viser import SceneApi

from mulan.geometry import so3
from mulan.report.covariance_shapes import SIGMAS_95_SPACE
from mulan.report.map_traces import RobotOnMap, bearing_segments, common_exaggeration, robots_on_map

_ROOT = "/mission"
_NAME_ABOVE_M = 0.08
_MOST_ELLIPSOIDS_A_ROBOT = 12
_TRUTH_COLOUR = (130, 130, 130)
_BEARING_COLOUR, _OUTLIER_COLOUR = (123, 135, 148), (214, 69, 69)


@dataclass(frozen=True)
class LayerChoice:
    """Which layers are shown.

    Attributes:
        paths, truth, ellipsoids, bearings: Each layer.
        until_s: Nothing later in the mission is shown.
    """

    paths: bool = True
    truth: bool = True
    ellipsoids: bool = True
    bearings: bool = False
    until_s: float = np.inf


def rgb(colour: str) -> tuple[int, int, int]:
    """A ``#rrggbb`` colour as numbers."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


class MissionLayers:
    """The localization of a run, drawn into a viser scene.

    Attributes:
        exaggeration: How many times their size the ellipsoids are drawn; the page states it.
        robots: What is drawn, by robot.
    """

    def __init__(self, scene: SceneApi, localization: dict[str, Any]) -> None:
        self._scene, self._localization = scene, localization
        self.robots = robots_on_map(localization)
        self.exaggeration = common_exaggeration(self.robots)

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last photograph."""
        times = np.concatenate([robot.time_s for robot in self.robots])
        return (float(times.min()), float(times.max())) if len(times) else (0.0, 0.0)

    def show(self, choice: LayerChoice) -> None:
        """Draw the chosen layers anew."""
        self.remove()
        for robot in self.robots:
            self._show_robot(robot, choice)
        if choice.bearings:
            self._show_bearings(choice)

    def remove(self) -> None:
        """Take all of them out of the scene."""
        self._scene.remove_by_name(_ROOT)

    def _show_robot(self, robot: RobotOnMap, choice: LayerChoice) -> None:
        root = f"{_ROOT}/{robot.name}"
        shown = robot.time_s <= choice.until_s
        path = _until(robot.path, robot.time_s, choice.until_s)
        if choice.paths and len(path) > 1:
            self._line(f"{root}/path", path, rgb(robot.colour), 3.0)
        if choice.truth and robot.truth is not None:
            truth = _until(robot.truth, robot.time_s, choice.until_s)
            if len(truth) > 1:
                self._line(f"{root}/truth", truth, _TRUTH_COLOUR, 1.5)
        if shown.any():
            here = robot.photos[shown][-1]
            self._scene.add_label(
                f"{root}/name", robot.name, position=(here[0], here[1], here[2] + _NAME_ABOVE_M)
            )
        if choice.ellipsoids:
            self._show_ellipsoids(root, robot, np.flatnonzero(shown))

    def _show_ellipsoids(self, root: str, robot: RobotOnMap, photos: Int[NDArray, "n"]) -> None:
        every = photos[:: max(1, -(-len(photos) // _MOST_ELLIPSOIDS_A_ROBOT))]
        for i in every:
            axes_m, R = ellipsoid_axes(robot.covariance[i])
            x, y, z, w = so3.to_quaternion(R)
            self._scene.add_icosphere(
                f"{root}/ellipsoid_{i}",
                radius=1.0,
                scale=tuple(np.maximum(axes_m * self.exaggeration, 1e-4)),
                color=rgb(robot.colour),
                opacity=0.25,
                subdivisions=2,
                wxyz=(w, x, y, z),
                position=tuple(robot.photos[i]),
                cast_shadow=False,
                receive_shadow=False,
            )

    def _show_bearings(self, choice: LayerChoice) -> None:
        segments, inlier = bearing_segments(self._localization, self.robots, choice.until_s)
        if len(segments):
            colours = np.where(inlier[:, None, None], _BEARING_COLOUR, _OUTLIER_COLOUR)
            colours = np.broadcast_to(colours, (len(segments), 2, 3)).astype(np.uint8)
            self._scene.add_line_segments(
                f"{_ROOT}/bearings", segments, colours, thickness=1.5, thickness_units="screen"
            )

    def _line(
        self, name: str, points: Float[NDArray, "n 3"], colour: tuple[int, int, int], width: float
    ) -> None:
        segments = np.stack([points[:-1], points[1:]], 1).astype(np.float32)
        self._scene.add_line_segments(name, segments, colour, thickness=width, thickness_units="screen")


def ellipsoid_axes(
    covariance: Float[NDArray, "3 3"],
) -> tuple[Float[NDArray, "3"], Float[NDArray, "3 3"]]:
    """Semi-axes [m] of the 95 % ellipsoid and the rotation that turns x, y, z into them."""
    eigenvalue, axes = np.linalg.eigh(covariance)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    return SIGMAS_95_SPACE * np.sqrt(np.clip(eigenvalue, 0, None)), axes


def _until(
    path: Float[NDArray, "p 3"], photo_time_s: Float[NDArray, "n"], until_s: float
) -> Float[NDArray, "q 3"]:
    """The part of a path walked by a time; its points carry none, so the photographs' are spread over it."""
    if not np.isfinite(until_s) or not len(photo_time_s):
        return path
    begin_s, end_s = photo_time_s[0], photo_time_s[-1]
    share = np.clip((until_s - begin_s) / max(end_s - begin_s, 1e-9), 0, 1)
    return path[: int(np.ceil(share * len(path)))]
