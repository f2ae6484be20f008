"""The mission of a soak test: as long as the test, so that its traffic is that of real time."""

from dataclasses import dataclass, replace
from pathlib import Path

from mulan.mission.bag_writer import write_mission
from mulan.simulation.from_scene import SceneMissionConfig, robot_cameras, simulate_from_scene
from mulan.simulation.radio import RadioConfig
from mulan.simulation.recording import SensorConfig, body_poses
from mulan.simulation.timeline import TourConfig, plan_motions
from mulan.simulation.tour import view_path

_MEASURING_SHARE = 0.6  # most of the mission that may be spent standing and measuring
_FASTEST_M_PER_S = 1.0
_TRIES = 4  # at finding the speed that fills the time


@dataclass(frozen=True)
class SoakMissionConfig:
    """Robots in the built-in room that photograph and measure at a steady pace."""

    robots: int = 3
    """Number of robots."""
    packets_per_second: float = 50.0
    """WiFi packet pairs a second and pair, while an antenna moves."""
    round_every_s: float = 60.0
    """Every robot moves its antenna once in so long, or as often as there is time for."""
    photograph_every_s: float = 20.0
    """Every robot photographs once in so long."""
    width: int = 96
    """Image width in pixels."""
    height: int = 72
    """Image height in pixels."""
    samples_per_pixel: int = 8
    """Light paths a pixel."""


def simulate_soak_mission(config: SoakMissionConfig, duration_s: float, seed: int, bag: Path) -> None:
    """Write a mission of about that length; with many robots and little time it is longer.

    Raises:
        InputError: Too few robots.
    """
    aperture_s = TourConfig().aperture.duration_s + TourConfig().settle_s
    most_rounds = _MEASURING_SHARE * duration_s / (aperture_s * config.robots)
    rounds = max(2, round(min(duration_s / config.round_every_s, most_rounds)))
    measuring_s = rounds * aperture_s * config.robots
    scene = SceneMissionConfig(
        robots=config.robots,
        photos_per_robot=max(rounds, 8, round(duration_s / config.photograph_every_s)),
        held_out=0,
        width=config.width,
        height=config.height,
        samples_per_pixel=config.samples_per_pixel,
        seed=seed,
        sensors=SensorConfig(radio=RadioConfig(packets_per_second=config.packets_per_second)),
    )
    pace = TourConfig(rounds=rounds)
    for _ in range(_TRIES):
        lasts_s = _length_s(scene, pace)
        speed = pace.speed_m_per_s * (lasts_s - measuring_s) / max(duration_s - measuring_s, 1e-3)
        speed = min(speed, _FASTEST_M_PER_S)
        pace = replace(pace, speed_m_per_s=speed, turn_rate_rad_per_s=speed)
    write_mission(simulate_from_scene(replace(scene, tour=pace)), bag)


def _length_s(scene: SceneMissionConfig, pace: TourConfig) -> float:
    """How long a mission at that pace lasts."""
    metres_per_radian = pace.speed_m_per_s / pace.turn_rate_rad_per_s
    ways = [body_poses(robot_cameras(scene, index)) for index in range(scene.robots)]
    return plan_motions([view_path(way, metres_per_radian) for way in ways], pace)[0].end_s
