"""One team run through the online solver at the pace of its mission."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.localization.online_team import OnlineTeamConfig, TrueRadio, make_online_team, pairs_due
from mulan.geometry import se3
from mulan.localization.online import OnlineConfig, OnlineLocalization
from mulan.localization.online_estimate import OnlineEstimate
from mulan.localization.scheduling import SchedulingConfig, next_measurements
from mulan.mission.types import RobotLog

Progress = Callable[[int, int, str], None]
_SETTLED_S = 60.0  # errors count from then on
YAW_AND_POSITION = slice(2, 6)
"""The bodies are level: roll and pitch are exact and would flatter the NEES."""


@dataclass(frozen=True)
class OnlineRun:
    """What one run showed.

    Attributes:
        online: The solver at the end.
        robots: The team.
        update_ms: Processor time of every update.
        error_m: Relative position errors to the anchor, every tenth second.
        nees_per_dof: Of the relative poses (heading and position), likewise.
        apertures: How many bearings were taken after the start.
        all_placed_s: When the last robot got its place.
    """

    online: OnlineLocalization
    robots: tuple[RobotLog, ...]
    update_ms: Float[NDArray, "n"]
    error_m: Float[NDArray, "q"]
    nees_per_dof: Float[NDArray, "q"]
    apertures: int
    all_placed_s: float

    @property
    def rms_m(self) -> float:
        """Of the relative positions."""
        return float(np.sqrt(np.mean(self.error_m**2)))


def relative_errors(
    estimate: OnlineEstimate, robots: Sequence[RobotLog], i: int
) -> tuple[list[float], list[float]]:
    """Position error and NEES a freedom of every robot as the anchor sees it at keyframe i."""
    truth = {r.name: r.ground_truth.T_world_body[i] for r in robots if r.ground_truth is not None}
    anchor = robots[0].name
    off, nees = [], []
    for name in estimate.names:
        if name == anchor:
            continue
        true = se3.inverse(truth[anchor]) @ truth[name]
        seen = se3.inverse(estimate.T_world_body[anchor]) @ estimate.T_world_body[name]
        xi = se3.log(se3.inverse(seen) @ true)[YAW_AND_POSITION]
        covariance = estimate.relative_covariance(anchor, name)[YAW_AND_POSITION, YAW_AND_POSITION]
        off.append(float(np.linalg.norm(seen[:3, 3] - true[:3, 3])))
        nees.append(float(xi @ np.linalg.solve(covariance, xi)) / 4)
    return off, nees


def run_team(
    seed: int,
    team: OnlineTeamConfig,
    config: OnlineConfig,
    scheduling: SchedulingConfig | None = None,
    progress: Progress | None = None,
) -> OnlineRun:
    """Feed the team's keyframes and radio to the solver second by second, one update each.

    Every pair measures in turn, both directions and a range; with ``scheduling``, after the first minute, one
    aperture and range are taken when and where it says instead.
    """
    rng = np.random.default_rng([seed, team.robots])
    robots, radio = make_online_team(rng, team), TrueRadio.draw(rng, team)
    at = {robot.name: k for k, robot in enumerate(robots)}
    online = OnlineLocalization(config)
    for robot in robots:
        online.add_robot(robot)
    time_s = robots[0].odometry.time_s
    update_ms, errors, nees = np.zeros(len(time_s)), [], []
    apertures, all_placed_s = 0, float("nan")
    every = max(1, round(team.radio_s / team.keyframe_s))
    for i, now_s in enumerate(time_s):
        for robot in robots:
            track = robot.odometry
            assert track.covariance is not None
            online.add_keyframe(robot.name, float(now_s), track.T_odom_body[i], track.covariance[i])
        if scheduling is None or now_s < _SETTLED_S:
            pairs = pairs_due(team.robots, i, every)
        else:
            due = next_measurements(online.estimate, scheduling)
            pairs = [(at[a.observer], at[a.peer]) for a in due]
        for a, b in pairs:
            online.add_bearing(radio.bearing(rng, robots[a], robots[b], i))
            if scheduling is None or now_s < _SETTLED_S:
                online.add_bearing(radio.bearing(rng, robots[b], robots[a], i))
                apertures += now_s >= _SETTLED_S
            apertures += now_s >= _SETTLED_S
            online.add_range(radio.range(rng, robots, a, b, i))
        begin = time.process_time()
        estimate = online.update()
        update_ms[i] = 1e3 * (time.process_time() - begin)
        if not estimate.waiting and np.isnan(all_placed_s):
            all_placed_s = float(now_s)
        if now_s >= _SETTLED_S and i % 10 == 9:
            off, squared = relative_errors(estimate, robots, i)
            errors += off
            nees += squared
        if progress is not None and i % 20 == 0:
            progress(i, len(time_s), f"{team.robots} robots")
    return OnlineRun(
        online, robots, update_ms, np.array(errors), np.array(nees), int(apertures), all_placed_s
    )
