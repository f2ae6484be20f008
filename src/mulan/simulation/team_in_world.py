"""Robots in a rendered world that go where they are told, photograph and measure; the mission grows."""

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from mulan.geometry.camera import PinholeCamera
from mulan.mission.types import HeldOutViews, Mission, OdometryTrack, Photo, PoseTrack, RobotLog
from mulan.simulation.from_scene import jpeg
from mulan.simulation.leg import Leg, joined, record_leg
from mulan.simulation.obstacles import Obstacles
from mulan.simulation.recording import (
    T_BODY_CAMERA,
    UWB_ANTENNA_BODY_M,
    WIFI_ANTENNA_BODY_M,
    SensorConfig,
    body_poses,
)
from mulan.simulation.timeline import ApertureConfig, RobotMotion, TourConfig, level_axes, plan_motions
from mulan.simulation.tour import view_path
from mulan.simulation.world import World

_TRIED_S = 0.05  # between the instants at which a motion is tried for collisions


class CollisionError(RuntimeError):
    """A robot was about to run into something; nothing has moved."""


@dataclass(frozen=True)
class TeamInWorldConfig:
    """What the robots are."""

    samples_per_pixel: int = 24
    """Light paths a pixel."""
    body_radius_m: float = 0.12
    """Half the width of a robot."""
    apart_m: float = 0.45
    """Least distance between the middles of two robots."""
    tour: TourConfig = field(
        default_factory=lambda: TourConfig(rounds=2, aperture=ApertureConfig(radius_m=0.15))
    )
    """Pace, and the antenna motions of each leg: at its begin and, with two rounds, at its end."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """Noise of odometry, WiFi and UWB."""


class TeamInWorld:
    """The true state of a team, and what it recorded so far.

    Attributes:
        world: Where they are.
        camera: The lens of all.
        T_world_body: True pose of each robot, by name.
        mission: What they recorded.
    """

    def __init__(
        self,
        world: World,
        camera: PinholeCamera,
        starts: Mapping[str, Float[NDArray, "4 4"]],
        config: TeamInWorldConfig,
        seed: int,
    ) -> None:
        """Place the robots; nothing is recorded yet.

        Args:
            world: Where they are.
            camera: The lens of all.
            starts: True camera pose of each robot at the start, by name; the first is the anchor.
            config: What the robots are.
            seed: Source of all randomness.
        """
        self.world, self.camera, self._config, self._seed = world, camera, config, seed
        self.T_world_body = {name: body_poses(T[None])[0] for name, T in starts.items()}
        self._obstacles = Obstacles(world.scene, config.body_radius_m)
        self._logs = {name: _empty_log(name, camera) for name in starts}
        self._legs, self._photographs, self._now_s = 0, 0, 0.0
        self._held_out: HeldOutViews | None = None

    def branch(self) -> "TeamInWorld":
        """A copy that goes its own way from here; both draw the same randomness for the same leg."""
        other = copy(self)
        other.T_world_body, other._logs = dict(self.T_world_body), dict(self._logs)
        return other

    @property
    def mission(self) -> Mission:
        """Everything recorded so far by the robots that moved at all."""
        robots = tuple(log for log in self._logs.values() if len(log.odometry.time_s))
        return Mission(robots, self._held_out)

    def hold_out(self, T_world_camera: Float[NDArray, "n 4 4"]) -> None:
        """Photograph test views from true poses, with twice the light paths."""
        photos = tuple(self._photograph(T, 2, float(k)) for k, T in enumerate(T_world_camera))
        self._held_out = HeldOutViews(self.camera, photos, T_world_camera)

    def tour(self, T_world_camera: Mapping[str, Float[NDArray, "n 4 4"]]) -> tuple[RobotLog, ...]:
        """Pass the given views, the first of which is where the robot stands, and photograph all of them.

        Returns:
            What was recorded on the way.

        Raises:
            CollisionError: A robot would run into something.
        """
        return self._drive(T_world_camera, dict.fromkeys(T_world_camera, 0))

    def go(self, T_world_camera: Mapping[str, Float[NDArray, "4 4"] | None]) -> tuple[RobotLog, ...]:
        """Go straight to a view each and photograph there; who has None stays, and still measures.

        Returns:
            What was recorded on the way.

        Raises:
            CollisionError: A robot would run into something.
        """
        ways = {}
        for name, goal in T_world_camera.items():
            here = self.T_world_body[name] @ T_BODY_CAMERA
            ways[name] = here[None] if goal is None else np.stack([here, goal])
        return self._drive(ways, dict.fromkeys(ways, 1))

    def can_go(
        self, name: str, goal: Float[NDArray, "4 4"], others: Mapping[str, Float[NDArray, "4 4"] | None]
    ) -> bool:
        """Whether a robot's own sensors let it go straight to a view and move its antenna there.

        Args:
            name: The robot.
            goal: True camera pose to go to.
            others: Goals of those that were let go before it; all further robots are taken to stay.
        """
        swept = self._swept(name, goal)
        for mate in self.T_world_body:
            if mate == name:
                continue
            if cdist(swept, self._swept(mate, others.get(mate))).min() < self._config.apart_m:
                return False
        return self._obstacles.is_way_free(swept)

    def _swept(self, name: str, goal: Float[NDArray, "4 4"] | None) -> Float[NDArray, "n 3"]:
        """Where the body passes: loop at the begin, the straight way, loop at the end."""
        here = self.T_world_body[name]
        if goal is None:
            return self._loop(here)
        there = body_poses(goal[None])[0]
        way = np.linspace(here[:3, 3], there[:3, 3], 12)
        return np.concatenate([self._loop(here), way, self._loop(there)])

    def _loop(self, T_world_body: Float[NDArray, "4 4"]) -> Float[NDArray, "n 3"]:
        offset = self._config.tour.aperture.displacement(np.linspace(0, 1, 24))
        return T_world_body[:3, 3] + offset @ level_axes(T_world_body[None, :3, :3])[0].T

    def _drive(
        self, ways: Mapping[str, Float[NDArray, "n 4 4"]], first_photograph: Mapping[str, int]
    ) -> tuple[RobotLog, ...]:
        metres_per_radian = self._config.tour.speed_m_per_s / self._config.tour.turn_rate_rad_per_s
        paths = [view_path(body_poses(way), metres_per_radian) for way in ways.values()]
        motions = dict(zip(ways, plan_motions(paths, self._config.tour), strict=True))
        self._check(motions)
        photos = {
            name: tuple(
                self._photograph(way[k], 1, self._now_s + float(motions[name].photo_time_s[k]))
                for k in range(first_photograph[name], len(way))
            )
            for name, way in ways.items()
        }
        leg = Leg(self._legs, self._now_s, motions, photos)
        recorded = record_leg(leg, self._logs, self.world.propagation, self._config.sensors, self._seed)
        for log in recorded:
            self._logs[log.name] = joined(self._logs[log.name], log)
        for name, way in ways.items():
            self.T_world_body[name] = body_poses(way[-1:])[0]
        self._legs, self._now_s = self._legs + 1, leg.end_s
        return recorded

    def _check(self, motions: Mapping[str, RobotMotion]) -> None:
        end_s = max(motion.end_s for motion in motions.values())
        time_s = np.arange(0.0, end_s + _TRIED_S, _TRIED_S)
        position_m = {name: np.tile(T[:3, 3], (len(time_s), 1)) for name, T in self.T_world_body.items()} | {
            name: motion.pose(time_s)[:, :3, 3] for name, motion in motions.items()
        }
        for name in motions:
            way_m = position_m[name]
            moved = np.linalg.norm(np.diff(way_m, axis=0, prepend=way_m[:1]), axis=1) > 1e-9
            moved[0] = True
            if not self._obstacles.is_way_free(way_m[moved]):
                raise CollisionError(f"{name} would run into something of the world")
            for mate, mate_m in position_m.items():
                if mate != name and np.linalg.norm(way_m - mate_m, axis=1).min() < 0.8 * self._config.apart_m:
                    raise CollisionError(f"{name} would run into {mate}")

    def _photograph(self, T_world_camera: Float[NDArray, "4 4"], times: int, time_s: float) -> Photo:
        samples = times * self._config.samples_per_pixel
        seed = self._seed * 100_003 + self._photographs
        self._photographs += 1
        return Photo(time_s, "jpeg", jpeg(self.world.scene, self.camera, T_world_camera, samples, seed))


def _empty_log(name: str, camera: PinholeCamera) -> RobotLog:
    nowhen, nowhere = np.zeros(0), np.zeros((0, 4, 4))
    return RobotLog(
        name=name,
        camera=camera,
        T_body_camera=T_BODY_CAMERA,
        wifi_antenna_body_m=WIFI_ANTENNA_BODY_M,
        uwb_antenna_body_m=UWB_ANTENNA_BODY_M,
        photos=(),
        odometry=OdometryTrack(nowhen, nowhere, np.zeros((0, 6, 6))),
        csi={},
        ranges={},
        ground_truth=PoseTrack(nowhen, nowhere),
    )
