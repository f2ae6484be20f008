"""The online solver at the pace of a mission: time and memory of its updates, errors, the batch beside."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.engine.peak_memory import peak_memory_gb, reset_peak_memory
from mulan.evaluation.localization.online_run import YAW_AND_POSITION, OnlineRun, Progress, run_team
from mulan.evaluation.localization.online_team import OnlineTeamConfig
from mulan.geometry import se3
from mulan.localization.online import OnlineConfig
from mulan.localization.online_batch import solve_batch
from mulan.localization.scheduling import SchedulingConfig
from mulan.localization.traffic import pair_traffic
from mulan.mission.run_folder import write_atomically

_LAST_S = 600.0  # update times at the end are those of the last ten minutes
_GOAL_MS = 50.0


@dataclass(frozen=True)
class OnlineEvaluationConfig:
    """Which teams are run, and for how long."""

    seed: int = 0
    """Of everything drawn."""
    hours: float = 1.0
    """Mission of the team of five."""
    large_team: int = 20
    """Robots of the larger team."""
    large_hours: float = 0.1
    """Its mission: the window is full after a minute, so that more would only repeat it."""
    scheduling_hours: float = 0.25
    """Mission on which apertures by the clock and by need are compared."""
    scheduling: SchedulingConfig = field(
        default_factory=lambda: SchedulingConfig(
            position_goal_m=0.08, heading_goal_deg=1.0, least_gain_nats=0.3, most=2
        )
    )
    """Goals of apertures by need: about what the clock reaches."""
    team: OnlineTeamConfig = field(default_factory=OnlineTeamConfig)
    """Motion, radio and noise of both."""
    online: OnlineConfig = field(default_factory=OnlineConfig)
    """The solver."""


def run_online(
    config: OnlineEvaluationConfig, progress: Progress | None = None
) -> tuple[dict[str, Any], dict[str, Float[NDArray, "n"]]]:
    """Figures for ``metrics.json`` and the update times of each team for the picture.

    Times are processor time of one thread, so that other programs on the machine do not count.
    """
    reset_peak_memory()
    run = run_team(config.seed, replace(config.team, hours=config.hours), config.online, progress=progress)
    five = _figures(run) | {"peak_memory_mb": 1e3 * peak_memory_gb()}
    five |= _beside_batch(run)
    mission = [
        replace(run.online.robots[robot.name].recorded(0, len(robot.odometry.time_s)), ranges=robot.ranges)
        for robot in run.robots
    ]
    traffic = pair_traffic(mission, run.online.bearings, config.team.keyframe_s)
    five["bytes_per_s_per_pair"] = max(pair.bytes_per_s for pair in traffic.values())
    large = run_team(
        config.seed,
        replace(config.team, robots=config.large_team, hours=config.large_hours),
        config.online,
        progress=progress,
    )
    times = {f"{config.team.robots} robots": run.update_ms, f"{config.large_team} robots": large.update_ms}
    metrics = five | {
        "goal_ms": _GOAL_MS,
        f"robots_{config.large_team}": _figures(large) | _beside_batch(large),
        "scheduling": _compare_schedules(config, progress),
    }
    return metrics, times


def _figures(run: OnlineRun) -> dict[str, Any]:
    duration_s = float(run.robots[0].odometry.time_s[-1])
    late = run.update_ms[-min(len(run.update_ms) // 2, round(_LAST_S)) :]
    return {
        "robots": len(run.robots),
        "hours": duration_s / 3600,
        "p50_update_ms": float(np.percentile(late, 50)),
        "p95_update_ms": float(np.percentile(late, 95)),
        "worst_update_ms": float(late.max()),
        "rms_m": run.rms_m,
        "nees_per_dof": float(run.nees_per_dof.mean()),
        "all_placed_s": run.all_placed_s,
        "dropped": run.online.dropped,
        "late": run.online.late,
    }


def _beside_batch(run: OnlineRun) -> dict[str, Any]:
    """How far newest poses, and all poses, are from the batch solution over the whole mission."""
    online = run.online.trajectories()
    solution, batch = solve_batch(run.online)
    anchor, claimed = run.robots[0].name, run.online.estimate.covariance
    newest, every, relative, sigmas = [], [], [], []
    for name, poses in batch.items():
        off = np.linalg.norm(poses[:, :3, 3] - online[name][:, :3, 3], axis=1)
        newest.append(off[-1])
        every.append(np.mean(off**2))
        xi = se3.log(se3.inverse(online[name][-1]) @ poses[-1])[YAW_AND_POSITION]
        covariance = claimed[name][YAW_AND_POSITION, YAW_AND_POSITION]
        sigmas.append(np.sqrt(xi @ np.linalg.solve(covariance, xi) / 4))
        if name != anchor:
            seen = [(se3.inverse(of[anchor]) @ of[name])[:, :3, 3] for of in (batch, online)]
            relative.append(np.linalg.norm(seen[0] - seen[1], axis=1))
    return {
        "difference_to_batch_m": float(max(newest)),
        "difference_to_batch_in_sigmas": float(max(sigmas)),
        "sigma_in_anchors_frame_m": float(max(np.sqrt(np.trace(claimed[n][3:, 3:])) for n in batch)),
        "relative_difference_to_batch_m": float(max(r[-1] for r in relative)),
        "rms_difference_along_the_way_m": float(np.sqrt(np.mean(every))),
        "rms_relative_difference_along_the_way_m": float(np.sqrt(np.mean(np.square(relative)))),
        "batch_bearing_inliers": float(solution.bearing_inlier.mean()),
    }


def _compare_schedules(config: OnlineEvaluationConfig, progress: Progress | None) -> dict[str, Any]:
    """Apertures by a ten-second clock against apertures by need, robots that drive and rest by turns."""
    team = replace(config.team, hours=config.scheduling_hours, rest_s=60.0)
    clock = run_team(config.seed, team, config.online, progress=progress)
    need = run_team(config.seed, team, config.online, config.scheduling, progress=progress)
    return {
        "hours": config.scheduling_hours,
        "clock": {"apertures": clock.apertures, "rms_m": clock.rms_m},
        "need": {
            "apertures": need.apertures,
            "rms_m": need.rms_m,
            "nees_per_dof": float(need.nees_per_dof.mean()),
        },
    }


def draw_online(times: dict[str, Float[NDArray, "n"]], path: Path) -> None:
    """Time of every update over the mission, with its median and 95th percentile a minute."""
    figure, axes = plt.subplots(1, len(times), figsize=(6 * len(times), 3.6), squeeze=False)
    for panel, (name, update_ms) in zip(axes[0], times.items(), strict=True):
        minutes = np.arange(len(update_ms)) / 60
        panel.plot(minutes, update_ms, ",", color="#9fb8c4")
        whole = len(update_ms) // 60
        if whole:
            blocks = update_ms[: whole * 60].reshape(whole, 60)
            middle = np.arange(whole) + 0.5
            panel.plot(middle, np.percentile(blocks, 50, axis=1), color="#0b6e99", label="median of a minute")
            panel.plot(middle, np.percentile(blocks, 95, axis=1), color="#d98324", label="95th percentile")
        panel.axhline(_GOAL_MS, color="black", lw=0.8, ls=":", label="goal, five robots")
        panel.set(
            xlabel="minute of the mission",
            ylabel="processor time of an update [ms]",
            title=name,
            ylim=(0, max(1.1 * _GOAL_MS, 1.5 * float(np.percentile(update_ms, 99)))),
        )
        panel.legend(fontsize=8)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120, bbox_inches="tight"))
    plt.close(figure)
