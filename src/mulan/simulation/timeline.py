"""Who moves when: every robot tours its views; at each round all stop and wave their antenna in turn."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.simulation.speed_profile import SpeedProfile
from mulan.simulation.tour import ViewPath


@dataclass(frozen=True)
class ApertureConfig:
    """The short loop a robot makes so that its moving antenna acts as an array."""

    radius_m: float = 0.25
    """Radius of the loop."""
    height_m: float = 0.15
    """Vertical extent; without it elevation cannot be told from its mirror image."""
    duration_s: float = 2.0
    """Time for one loop."""
    planar: bool = False
    """Stay level, as ground robots must."""

    def displacement(self, fraction: Float[NDArray, "n"]) -> Float[NDArray, "n 3"]:
        """Offset (forward, left, up) at a fraction 0..1 of the loop, starting and ending at rest at zero."""
        angle = np.pi * (1 - np.cos(np.pi * np.clip(fraction, 0.0, 1.0)))
        # two rises a turn: a tilted circle would be flat, and flat loops have mirror images
        up = np.zeros_like(angle) if self.planar else self.height_m / 2 * np.sin(2 * angle)
        return np.stack([self.radius_m * np.sin(angle), self.radius_m * (1 - np.cos(angle)), up], -1)


@dataclass(frozen=True)
class TourConfig:
    """Pace of a mission."""

    speed_m_per_s: float = 1.0
    """Cruising speed."""
    acceleration_m_per_s2: float = 1.0
    """Of every start and stop."""
    turn_rate_rad_per_s: float = 1.0
    """Fastest turn at cruising speed."""
    rounds: int = 10
    """Stops, evenly spread over the tour, at which every robot in turn moves its antenna."""
    settle_s: float = 0.3
    """Standstill before and after each antenna motion."""
    pose_rate_hz: float = 50.0
    """Rate of odometry and true poses."""
    aperture: ApertureConfig = field(default_factory=ApertureConfig)
    """The antenna motion."""


@dataclass(frozen=True)
class RobotMotion:
    """True motion of one robot over the whole mission, at any instant.

    Attributes:
        path: The curve it follows.
        leg_start_s, leg_from_m, leg_to_m: Drives along the curve; it stands still between them.
        photo_time_s: When it passes each pose of the path.
        aperture_s: Begin and end of its antenna motions; disjoint from every other robot's.
        end_s: End of the mission, shared by all robots.
        config: The pace.
    """

    path: ViewPath
    leg_start_s: Float[NDArray, "l"]
    leg_from_m: Float[NDArray, "l"]
    leg_to_m: Float[NDArray, "l"]
    photo_time_s: Float[NDArray, "n"]
    aperture_s: Float[NDArray, "k 2"]
    end_s: float
    config: TourConfig

    def pose(self, time_s: Float[NDArray, "q"]) -> Float[NDArray, "q 4 4"]:
        """True body poses."""
        along_m = np.full(time_s.shape, self.leg_from_m[0])
        legs = zip(self.leg_start_s, self.leg_from_m, self.leg_to_m, strict=True)
        for start_s, from_m, to_m in legs:
            begun = time_s >= start_s
            leg = _profile(float(to_m - from_m), self.config)
            along_m[begun] = from_m + leg.distance_at(time_s[begun] - start_s)
        T = self.path.pose(along_m)
        for begin_s, end_s in self.aperture_s:
            inside = (time_s > begin_s) & (time_s < end_s)
            offset = self.config.aperture.displacement((time_s[inside] - begin_s) / (end_s - begin_s))
            T[inside, :3, 3] += (level_axes(T[inside, :3, :3]) @ offset[:, :, None])[:, :, 0]
        return T

    def point(self, time_s: Float[NDArray, "q"], lever_body_m: Float[NDArray, "3"]) -> Float[NDArray, "q 3"]:
        """True world positions of a point fixed to the body."""
        return se3.transform(self.pose(time_s), np.broadcast_to(lever_body_m, (len(time_s), 3)))

    def sample_times(self) -> Float[NDArray, "n"]:
        """The pose clock, with every exposure time among its ticks."""
        tick_s = 1.0 / self.config.pose_rate_hz
        grid = np.arange(0.0, self.end_s, tick_s)
        gap = np.abs(grid[:, None] - self.photo_time_s[None, :]).min(axis=1)
        return np.sort(np.concatenate([grid[gap > 0.1 * tick_s], self.photo_time_s]))


def level_axes(R: Float[NDArray, "n 3 3"]) -> Float[NDArray, "n 3 3"]:
    """Horizontal forward, horizontal left and up of tilted bodies; left stays defined when looking down."""
    up = np.broadcast_to([0.0, 0.0, 1.0], R.shape[:-1])
    left = R[..., :, 1] * [1.0, 1.0, 0.0]
    norm = np.linalg.norm(left, axis=-1, keepdims=True)
    left = np.where(norm > 1e-6, left / np.maximum(norm, 1e-6), [0.0, 1.0, 0.0])
    return np.stack([np.cross(left, up), left, up], -1)


def _profile(distance_m: float, config: TourConfig) -> SpeedProfile:
    return SpeedProfile(distance_m, config.speed_m_per_s, config.acceleration_m_per_s2)


def stop_views(views: int, rounds: int) -> Int[NDArray, "rounds"]:
    """Views at which a robot stops: first and last included, the middle one if there is a single round."""
    if rounds == 1:
        return np.array([(views - 1) // 2])
    return np.round(np.linspace(0, views - 1, rounds)).astype(int)


def plan_motions(
    paths: Sequence[ViewPath], config: TourConfig, measuring: Collection[int] | None = None
) -> tuple[RobotMotion, ...]:
    """Motions of all robots on one clock, apertures strictly one after another.

    Args:
        paths: Of each robot.
        config: The pace.
        measuring: Numbers of the robots that move their antenna at the stops; all if not given.
    """
    stops = [stop_views(len(path.knot_m), config.rounds) for path in paths]
    at = [0] * len(paths)
    photos = [np.full(len(path.knot_m), config.settle_s) for path in paths]
    legs: list[list[tuple[float, float, float]]] = [[] for _ in paths]
    apertures: list[list[tuple[float, float]]] = [[] for _ in paths]
    clock_s = config.settle_s
    for turn in range(config.rounds + 1):
        arrival_s = clock_s
        for r, path in enumerate(paths):
            goal = int(stops[r][turn]) if turn < config.rounds else len(path.knot_m) - 1
            from_m, to_m = float(path.knot_m[at[r]]), float(path.knot_m[goal])
            leg = _profile(to_m - from_m, config)
            legs[r].append((clock_s, from_m, to_m))
            photos[r][at[r] + 1 : goal + 1] = clock_s + leg.time_at(
                path.knot_m[at[r] + 1 : goal + 1] - from_m
            )
            arrival_s = max(arrival_s, clock_s + leg.duration_s)
            at[r] = goal
        clock_s = arrival_s + config.settle_s
        if turn < config.rounds:
            for r in range(len(paths)) if measuring is None else sorted(measuring):
                apertures[r].append((clock_s, clock_s + config.aperture.duration_s))
                clock_s += config.aperture.duration_s + config.settle_s
    motions = []
    for r, path in enumerate(paths):
        start_s, from_m, to_m = np.array(legs[r]).T
        aperture_s = np.array(apertures[r], dtype=float).reshape(-1, 2)
        motions.append(RobotMotion(path, start_s, from_m, to_m, photos[r], aperture_s, clock_s, config))
    return tuple(motions)
