"""Bearings from Sionna RT's channels beside those from the built-in mirrors: same robots, poses and noise.

python benchmarks/radio_scene.py --out runs/radio_scene

Needs the extra 'sionna'. Robots tour a built-in world and move their antennas as in 'mulan simulate'; only
what carries the radio differs. A link is "hidden" if something that is rendered stands between the antennas.
What is measured is written after each mission.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import tyro

from mulan.evaluation.provenance import provenance
from mulan.geometry import se3
from mulan.mission.run_folder import write_json
from mulan.mission.types import Mission, RobotLog
from mulan.simulation.from_scene import SceneMissionConfig, robot_cameras
from mulan.simulation.propagation import Propagation
from mulan.simulation.radio_kind import RadioKind
from mulan.simulation.recording import CameraTour, SensorConfig, plan_camera_tours, record_mission
from mulan.simulation.sionna_config import SionnaConfig
from mulan.simulation.timeline import TourConfig
from mulan.simulation.world_kind import WorldKind
from mulan.wireless.azimuth_density import azimuth_mixture, wrapped
from mulan.wireless.bearing import BearingConfig, KeepProfile, estimate_bearings
from mulan.wireless.directions import tangent_basis
from mulan.wireless.types import Bearing

_NEAR_DEG = 10.0


@dataclass(frozen=True)
class Options:
    """The same missions heard by mirrors and by Sionna RT."""

    out: Path
    """Folder for metrics.json and radio-scene.png."""
    worlds: tuple[WorldKind, ...] = (WorldKind.ROOM, WorldKind.CORRIDOR)
    """Built-in worlds."""
    robots: int = 3
    """Number of robots."""
    views: int = 16
    """Views each robot passes; nothing is photographed."""
    rounds: int = 4
    """Stops at which every robot in turn moves its antenna."""
    seeds: tuple[int, ...] = (0, 1)
    """Missions a world."""
    sionna: SionnaConfig = field(default_factory=SionnaConfig)
    """How rays are traced."""


@dataclass(frozen=True)
class Heard:
    """One bearing beside the truth.

    Attributes:
        error_deg: Angle between the first hypothesis and the truth.
        best_of_three_deg: Smallest such angle of the first three hypotheses.
        azimuth_error_deg: Of the first hypothesis, signed.
        nees: Squared error of the first hypothesis over its covariance, a degree of freedom.
        level: Smallest highest-density region of azimuth that holds the truth, 0..1.
        nll: Negative log-likelihood of the true azimuth [nats].
        weight: Of the first hypothesis.
        hidden: Whether something stands between the antennas.
        distance_m: Between them.
    """

    error_deg: float
    best_of_three_deg: float
    azimuth_error_deg: float
    nees: float
    level: float
    nll: float
    weight: float
    hidden: bool
    distance_m: float


def true_pose(robot: RobotLog, time_s: float) -> np.ndarray:
    track = robot.ground_truth
    assert track is not None
    return se3.interpolate(track.time_s, track.T_world_body, np.array([time_s]))[0]


def heard(bearing: Bearing, mission: Mission, scene: Any) -> Heard:
    """Compare with the truth, in the observer's odometry axes at the reference instant."""
    robots = {robot.name: robot for robot in mission.robots}
    observer, peer = robots[bearing.observer], robots[bearing.peer]
    T_odom_world = bearing.T_odom_body @ se3.inverse(true_pose(observer, bearing.time_s)[None])[0]
    peer_world_m = se3.transform(true_pose(peer, bearing.peer_time_s), peer.wifi_antenna_body_m)
    assert bearing.origin_odom_m is not None
    origin_world_m = se3.transform(se3.inverse(T_odom_world[None])[0], bearing.origin_odom_m)
    way = se3.transform(T_odom_world, peer_world_m) - bearing.origin_odom_m
    distance_m = float(np.linalg.norm(way))
    truth = way / distance_m
    off = np.degrees(np.arccos(np.clip(bearing.direction_odom @ truth, -1, 1)))
    first = bearing.direction_odom[0]
    tangent = tangent_basis(first).T @ (truth - first)
    seen_axes = np.isfinite(np.diag(bearing.tangent_covariance[0]))
    tangent, spread = tangent[seen_axes], bearing.tangent_covariance[0][np.ix_(seen_axes, seen_axes)]
    azimuth, mixture = float(np.arctan2(truth[1], truth[0])), azimuth_mixture(bearing)
    ray: Any = mi.Ray3f
    blocked = scene.ray_test(
        ray(origin_world_m.tolist(), (peer_world_m - origin_world_m).tolist(), 1.0, 0.0, [])
    )
    return Heard(
        error_deg=float(off[0]),
        best_of_three_deg=float(off[:3].min()),
        azimuth_error_deg=float(np.degrees(wrapped(np.array(mixture.mean_rad[0] - azimuth)))),
        nees=float(tangent @ np.linalg.solve(spread, tangent) / len(tangent)),
        level=float(mixture.level_of(np.array([azimuth]))[0]),
        nll=float(-mixture.log_density(np.array([azimuth]))[0]),
        weight=float(bearing.weight[0]),
        hidden=bool(blocked),
        distance_m=distance_m,
    )


def mission_heard_by(
    propagation: Propagation, tours: Sequence[CameraTour], options: Options, seed: int
) -> Mission:
    """The robots' logs, without photographs."""
    motions = plan_camera_tours(tours, TourConfig(rounds=options.rounds))
    return record_mission(tours, motions, propagation, SensorConfig(), None, seed)


def figures(found: Sequence[Heard]) -> dict[str, Any]:
    """Errors, and how honest the claims about them are."""
    if not found:
        return {"bearings": 0}
    error, best, nees, level, nll = (
        np.array([getattr(one, name) for one in found])
        for name in ("error_deg", "best_of_three_deg", "nees", "level", "nll")
    )
    near = error <= _NEAR_DEG
    return {
        "bearings": len(found),
        "mean_error_deg": float(error.mean()),
        "median_error_deg": float(np.median(error)),
        "p90_error_deg": float(np.quantile(error, 0.9)),
        "first_within_10deg": float(near.mean()),
        "best_of_three_within_10deg": float((best <= _NEAR_DEG).mean()),
        "nees_per_dof_median": float(np.median(nees)),
        "nees_per_dof_within_10deg": float(nees[near].mean()) if near.any() else None,
        "coverage_68": float((level <= 0.68).mean()),
        "coverage_95": float((level <= 0.95).mean()),
        "mean_nll": float(nll.mean()),
    }


def draw(rows: dict[str, dict[str, list[Heard]]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2 * len(rows), figsize=(5.2 * 2 * len(rows), 4), squeeze=False)
    colours = {RadioKind.MIRRORS.value: "#0b6e99", RadioKind.SIONNA.value: "#c0504d"}
    for k, (world, by_radio) in enumerate(rows.items()):
        errors, honesty = panels[0][2 * k], panels[0][2 * k + 1]
        for radio, found in by_radio.items():
            share = (np.arange(len(found)) + 1) / max(len(found), 1)
            errors.step(
                np.sort([one.error_deg for one in found]),
                share,
                where="post",
                color=colours[radio],
                label=radio,
            )
            honesty.plot(np.sort([one.level for one in found]), share, color=colours[radio], label=radio)
        errors.set(xscale="log", xlabel="error of the first hypothesis [deg]", ylabel="share of bearings")
        errors.set_title(f"{world}: errors")
        honesty.plot([0, 1], [0, 1], "k:", lw=1, label="honest")
        honesty.set(
            xlabel="claimed probability", ylabel="share of truths within", title=f"{world}: intervals"
        )
        for panel in (errors, honesty):
            panel.grid(alpha=0.3)
            panel.legend(fontsize=8)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)


def main(options: Options) -> None:
    options.out.mkdir(parents=True, exist_ok=True)
    result: dict[str, Any] = {
        "provenance": provenance(options.seeds[0]) | {"seeds": list(options.seeds)},
        "config": asdict(options) | {"out": None, "worlds": [world.value for world in options.worlds]},
        "worlds": {},
    }
    rows: dict[str, dict[str, list[Heard]]] = {}
    bearing_config = BearingConfig(keep_profile=KeepProfile.NONE)
    # each robot is the one that moves once a round, for each of its mates
    apertures_each = options.robots * (options.robots - 1) * options.rounds
    for kind in options.worlds:
        scene_config = SceneMissionConfig(
            robots=options.robots, photos_per_robot=options.views, world=kind, sionna=options.sionna
        )
        mirrors = scene_config.build()
        traced = replace(scene_config, radio=RadioKind.SIONNA).build()
        rows[kind.value] = {radio.value: [] for radio in RadioKind}
        for number, seed in enumerate(options.seeds, 1):
            config = replace(scene_config, seed=seed)
            tours = [
                CameraTour(config.camera, robot_cameras(config, k), "jpeg", (b"",) * options.views)
                for k in range(options.robots)
            ]
            for radio, world in ((RadioKind.MIRRORS, mirrors), (RadioKind.SIONNA, traced)):
                mission = mission_heard_by(world.propagation, tours, options, seed)
                bearings = estimate_bearings(mission.robots, bearing_config)
                rows[kind.value][radio.value] += [
                    heard(bearing, mission, world.scene) for bearing in bearings
                ]
            result["worlds"][kind.value] = {
                radio: {
                    "apertures": number * apertures_each,
                    "all": figures(found),
                    "seen": figures([one for one in found if not one.hidden]),
                    "hidden": figures([one for one in found if one.hidden]),
                }
                for radio, found in rows[kind.value].items()
            }
            write_json(options.out / "metrics.json", result)
            draw(rows, options.out / "radio-scene.png")
            for radio, found in result["worlds"][kind.value].items():
                print(kind.value, f"{number} missions", radio, found["all"], flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options, config=(tyro.conf.EnumChoicesFromValues,)))
