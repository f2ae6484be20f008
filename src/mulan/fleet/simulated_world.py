"""A simulated world that robots' programs share: they say where to go, it says what they recorded."""

import os
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.fleet.world_folder import WorldFolder
from mulan.geometry import se3
from mulan.mission.bag_writer import write_mission
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import read_json, write_atomically, write_json
from mulan.mission.types import HeldOutViews, Mission
from mulan.simulation.from_scene import SceneMissionConfig, held_out_cameras, robot_cameras
from mulan.simulation.recording import T_BODY_CAMERA, robot_names
from mulan.simulation.team_in_world import CollisionError, TeamInWorld, TeamInWorldConfig
from mulan.simulation.timeline import ApertureConfig, TourConfig

_LOOK_EVERY_S = 0.05

Camera = Float[NDArray, "4 4"]


def _pace() -> TourConfig:
    return TourConfig(rounds=1, aperture=ApertureConfig(radius_m=0.15))


@dataclass(frozen=True)
class WorldConfig:
    """A world, its robots, and how long they are in it."""

    minutes: float = 2.0
    """Wall-clock time after which no further leg begins."""
    photos_per_leg: int = 3
    """Photographs of each robot on the way of a leg."""
    measure: Literal["always", "asked"] = "always"
    """Robots move their antennas on every leg, or only on those on which the base station asked them to (and
    as long as it has not said anything)."""
    patience_s: float = 15.0
    """A robot that does not say for so long where it wants to go takes no part in a leg."""
    scene: SceneMissionConfig = field(
        default_factory=lambda: SceneMissionConfig(
            width=96, height=72, samples_per_pixel=16, photos_per_robot=24
        )
    )
    """The world, the lens, and the tour of a robot that has no goal."""
    team: TeamInWorldConfig = field(default_factory=lambda: TeamInWorldConfig(tour=_pace()))
    """What the robots are."""


@dataclass(frozen=True)
class _Wish:
    """What a robot wants on a leg.

    Attributes:
        goal: True camera pose to go to; None where it may go on along its tour.
        measures: Whether it moves its antenna.
    """

    goal: Camera | None
    measures: bool


class SimulatedWorld:
    """Moves the true robots leg by leg, each to its goal where that is free, else on along its tour.

    Attributes:
        folder: What lies between the world and the robots.
        legs: How many were driven.
        obeyed: Goals gone to, by robot.
    """

    def __init__(
        self, folder: Path, config: WorldConfig, tell: Callable[[str], object] = lambda _: None
    ) -> None:
        """Build the world and photograph its test views.

        Args:
            folder: A new one.
            config: Options.
            tell: Called with a sentence when something happens that a person should know.

        Raises:
            InputError: The folder holds an earlier world or cannot be written, or the scene cannot be used.
        """
        self.folder = WorldFolder(folder)
        if self.folder.world.exists():
            raise InputError(folder, "folder", "holds an earlier world", "choose another folder")
        self.legs = 0
        self._config, self._tell = config, tell
        self._names = robot_names(config.scene.robots, "world")
        self.obeyed = dict.fromkeys(self._names, 0)
        self._tours = {name: robot_cameras(config.scene, i) for i, name in enumerate(self._names)}
        self._next = dict.fromkeys(self._names, 1)
        starts = {name: tour[0] for name, tour in self._tours.items()}
        scene = config.scene
        team = replace(config.team, samples_per_pixel=scene.samples_per_pixel, sensors=scene.sensors)
        self._team = TeamInWorld(scene.build(), scene.camera, starts, team, scene.seed)
        if scene.held_out:
            self._team.hold_out(held_out_cameras(scene))
            assert self._team.mission.held_out is not None
            _write_held_out(self._team.mission.held_out, self.folder.held_out)
        write_json(self.folder.world, {"robots": list(self._names)})

    def run(self, stop: Callable[[], bool] = lambda: False) -> None:
        """Drive leg after leg until the time is over or told to stop.

        Raises:
            InputError: The disk is full.
        """
        until_s = time.monotonic() + 60 * self._config.minutes
        while not stop() and time.monotonic() < until_s:
            wishes = self._wishes(stop) if self.legs else dict.fromkeys(self._names, _Wish(None, True))
            if wishes:
                self._drive(wishes)
        write_json(self.folder.over, {"legs": self.legs, "obeyed": self.obeyed})

    def _wishes(self, stop: Callable[[], bool]) -> dict[str, "_Wish"]:
        """Of the robots that say in time where they want to go."""
        until_s = time.monotonic() + self._config.patience_s
        wanted = {name: self.folder.wish(name, self.legs) for name in self._names}
        while not stop() and time.monotonic() < until_s and not all(p.exists() for p in wanted.values()):
            time.sleep(_LOOK_EVERY_S)
        found: dict[str, _Wish] = {}
        for name, path in wanted.items():
            if not path.exists():
                continue
            wish = read_json(path, "mulan fleet robot")
            T_here_body, goal = wish.get("T_here_body"), None
            if T_here_body is not None:
                # a robot drives by what it sees of its own motion, not by where it truly is
                T_world_body = self._team.T_world_body[name] @ np.array(T_here_body, dtype=float)
                goal = T_world_body @ T_BODY_CAMERA
            found[name] = _Wish(goal, bool(wish.get("measures", True)))
        return found

    def _drive(self, wishes: Mapping[str, "_Wish"]) -> None:
        """One leg of those who take part."""
        always = self._config.measure == "always"
        measuring = {name for name, wish in wishes.items() if always or wish.measures}
        ways: dict[str, Float[NDArray, "n 4 4"]] = {}
        ends: dict[str, Camera | None] = {}
        for name in (name for name in self._names if name in wishes):
            ways[name] = self._way(name, wishes[name].goal, ends)
            ends[name] = ways[name][-1]
        try:
            logs = self._team.tour(ways, measuring)
        except CollisionError as error:
            self._tell(f"{error}; all stay on this leg")
            logs = self._team.tour({name: way[:1] for name, way in ways.items()}, measuring)
        beside = self.folder.root / ".leg"
        shutil.rmtree(beside, ignore_errors=True)
        for log in logs:
            write_mission(Mission((log,)), beside / f"{log.name}.mcap")
        os.replace(beside, self.folder.leg(self.legs))
        self.legs += 1

    def _way(
        self, name: str, goal: Camera | None, others: Mapping[str, Camera | None]
    ) -> Float[NDArray, "n 4 4"]:
        """Views to pass, the first where the robot stands: to its goal, else on along its tour, else none."""
        here = self._team.T_world_body[name] @ T_BODY_CAMERA
        count = self._config.photos_per_leg
        if goal is not None:
            if self._team.can_go(name, goal, others):
                self.obeyed[name] += 1
                share = np.linspace(0.0, 1.0, count)
                return se3.interpolate(np.array([0.0, 1.0]), np.stack([here, goal]), share)
            self._tell(f"{name}: the way to its goal is not free, it goes on with its tour")
        tour = self._tours[name]
        for ahead in range(len(tour)):
            at = (self._next[name] + ahead) % len(tour)
            if not self._team.can_go(name, tour[at], others):
                continue
            end = min(at + count - 1, len(tour))
            self._next[name] = end % len(tour)
            return np.concatenate([here[None], tour[at:end]])
        return here[None]


def _write_held_out(views: HeldOutViews, path: Path) -> None:
    images = []
    for index, (photo, T) in enumerate(zip(views.photos, views.T_world_camera, strict=True)):
        file = path.parent / f"{index:03d}.jpg"
        write_atomically(file, lambda temporary, data=photo.data: temporary.write_bytes(data))
        images.append(PosedImage(file, views.camera, T))
    write_transforms(PosedImageSet((), tuple(images), path), path)
