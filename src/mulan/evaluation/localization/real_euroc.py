"""EuRoC flights of one room as three robots: real odometry, radio drawn on the true motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.evaluation.localization.drawn_radio import DrawnRadioConfig, Instants, draw_radio
from mulan.evaluation.localization.flight_picture import draw_flights
from mulan.evaluation.localization.flights import (
    Flight,
    as_robot,
    on_estimators_body,
    read_flight,
    resampled,
    shared_instants,
    turned_about_vertical,
)
from mulan.evaluation.localization.paper_fix import initial_fix
from mulan.evaluation.localization.relative_score import RelativeErrors, figures, relative_errors, solved_pair
from mulan.geometry import se3
from mulan.localization.graph import LocalizationConfig
from mulan.localization.keyframes import OdometryNoise
from mulan.localization.marginals import TeamMarginals
from mulan.localization.odometry_correction import OdometryCorrection
from mulan.localization.odometry_learning import learn_odometry
from mulan.localization.trust import solve_trusting
from mulan.mission.types import RobotLog
from mulan.wireless.types import Bearing, Range

Pair = tuple[str, str]


@dataclass(frozen=True)
class EurocConfig:
    """How flights become a team."""

    radio: DrawnRadioConfig = field(default_factory=DrawnRadioConfig)
    """What is drawn on the true motion."""
    localization: LocalizationConfig = field(default_factory=LocalizationConfig)
    """The graph; scale and drift of the odometry are learned from the radio."""
    score_every_s: float = 1.0
    """Interval of the instants scored."""
    known_within_s: float = 0.1
    """A pose counts as known this near to a sample of the odometry (key-frame tracks have gaps)."""
    filled_hz: float = 20.0
    """Key-frame tracks are filled in to this rate."""


@dataclass(frozen=True)
class Team:
    """Flights, their logs, and the instants of the radio and the score, by pair."""

    flights: Mapping[str, Flight]
    robots: Mapping[str, RobotLog]
    bearing_s: Instants
    range_s: Instants
    score_s: Instants
    mounting_deg: Mapping[str, list[float]]


def gather_team(data: Path, sequences: Sequence[str], estimate: str, config: EurocConfig) -> Team:
    """Flights of one room, replayed at the same time.

    Raises:
        InputError: A file is missing or damaged.
    """
    flights, mounting = {}, {}
    for name in sequences:
        flights[name], turn = on_estimators_body(read_flight(data / "euroc_vio" / name, estimate))
        mounting[name] = np.degrees(turn).round(3).tolist()
    instants: list[dict[Pair, NDArray]] = [{}, {}, {}]
    pairs = list(combinations(sequences, 2))
    for number, pair in enumerate(pairs):
        turn = (number + 0.5) / len(pairs)
        radio = config.radio
        for which, every_s, begin in (
            (0, radio.bearing_every_s, turn),
            (1, 1 / radio.range_rate_hz, turn),
            (2, config.score_every_s, 0.0),
        ):
            first, second = (flights[name] for name in pair)
            instants[which][pair] = shared_instants(
                first, second, begin * every_s, every_s, config.known_within_s
            )
    robots = {}
    for name, flight in flights.items():
        scored = [times for pair, times in instants[2].items() if name in pair]
        dense = flight
        if np.median(np.diff(flight.odometry.time_s)) > 1.5 / config.filled_hz:
            dense = replace(flight, odometry=resampled(flight.odometry, config.filled_hz))
        robots[name] = as_robot(dense, np.unique(np.concatenate(scored)))
    return Team(flights, robots, instants[0], instants[1], instants[2], mounting)


def _poses(team: Team, pair: Pair, true: bool) -> tuple[NDArray, NDArray]:
    tracks = []
    for name in pair:
        log = team.robots[name]
        assert log.ground_truth is not None
        track = (
            (log.ground_truth.time_s, log.ground_truth.T_world_body)
            if true
            else (log.odometry.time_s, log.odometry.T_odom_body)
        )
        tracks.append(se3.interpolate(*track, team.score_s[pair]))
    return tracks[0], tracks[1]


def _through_frames(team: Team, T_world_odom: Mapping[str, Float[NDArray, "4 4"]]) -> list[RelativeErrors]:
    """Odometry of each robot laid through one fixed start frame."""
    errors = []
    for pair in team.score_s:
        if pair[0] in T_world_odom and pair[1] in T_world_odom:
            own = _poses(team, pair, true=False)
            estimate = (T_world_odom[pair[0]] @ own[0], T_world_odom[pair[1]] @ own[1])
            errors.append(relative_errors(pair, team.score_s[pair], estimate, _poses(team, pair, true=True)))
    return errors


def odometry_best_aligned(team: Team) -> list[RelativeErrors]:
    """Odometry alone, each track laid on its truth as well as yaw and translation can."""
    frames = {}
    for name, log in team.robots.items():
        times = np.unique(np.concatenate([t for pair, t in team.score_s.items() if name in pair]))
        assert log.ground_truth is not None
        own = se3.interpolate(log.odometry.time_s, log.odometry.T_odom_body, times)
        true = se3.interpolate(log.ground_truth.time_s, log.ground_truth.T_world_body, times)
        frames[name] = turned_about_vertical(own[:, :3, 3], true[:, :3, 3])
    return _through_frames(team, frames)


def papers_scheme(team: Team, bearings: Sequence[Bearing], ranges: Sequence[Range]) -> list[RelativeErrors]:
    """One initial fix of each robot to the first, odometry after that."""
    anchor, *others = team.robots.values()
    frames = {anchor.name: np.eye(4)}
    for robot in others:
        fix = initial_fix(anchor, robot, bearings, ranges)
        if fix is not None:
            frames[robot.name] = fix
    return _through_frames(team, frames)


@dataclass(frozen=True)
class TeamRun:
    """One drawing of the radio: errors by scheme, and what was learned of the odometry."""

    ours: list[RelativeErrors]
    default_noise: list[RelativeErrors]
    paper: list[RelativeErrors]
    odometry: Mapping[str, OdometryCorrection]
    suspects: tuple[str, ...]
    bearings: int
    ranges: int


def run_once(team: Team, seed: int, config: EurocConfig) -> TeamRun:
    """Draw the radio and localise as ``mulan localize`` does; score before and after odometry is learned."""
    bearings, ranges = draw_radio(
        np.random.default_rng(seed), team.robots, team.bearing_s, team.range_s, config.radio
    )
    robots = tuple(team.robots.values())
    first = solve_trusting(robots, bearings, ranges, config.localization)
    placed = [robot for robot in robots if robot.name in first.graph.robots]
    learned = learn_odometry(placed, first.graph, first.solution)
    given = TeamMarginals(first.graph, first.solution)
    errors: list[list[RelativeErrors]] = []
    for graph, solution, marginals in (
        (learned.graph, learned.solution, learned.marginals),
        (first.graph, first.solution, given),
    ):
        scored = []
        for pair, times in team.score_s.items():
            a, b, covariance = solved_pair(graph, solution, marginals, pair, times)
            scored.append(relative_errors(pair, times, (a, b), _poses(team, pair, true=True), covariance))
        errors.append(scored)
    return TeamRun(
        errors[0],
        errors[1],
        papers_scheme(team, bearings, ranges),
        learned.corrections,
        tuple(suspect.robot for suspect in first.suspects),
        len(bearings),
        len(ranges),
    )


def _learned(runs: Sequence[TeamRun], name: str, noise: OdometryNoise) -> dict[str, float]:
    """Medians over the drawings of one robot's scale and drift."""
    found = [run.odometry[name] for run in runs]
    return {
        "scale": float(np.median([c.scale for c in found])),
        "translation_percent": float(
            noise.translation_percent * np.median([c.translation_noise for c in found])
        ),
        "rotation_deg_per_sqrt_m": float(
            noise.rotation_deg_per_sqrt_m * np.median([c.heading_noise for c in found])
        ),
    }


def _median(runs: Sequence[TeamRun], name: str) -> float:
    return float(np.median([getattr(run, name) for run in runs]))


def run_team(
    data: Path,
    sequences: Sequence[str],
    estimate: str,
    seeds: Sequence[int],
    config: EurocConfig,
    picture: Path | None,
) -> dict[str, Any]:
    """All drawings of the radio on one team of flights, as they go into ``metrics.json``."""
    team = gather_team(data, sequences, estimate, config)
    if not any(len(times) for times in team.score_s.values()):
        raise InputError(data / "euroc_vio", "time", "no two flights overlap", "give flights of one room")
    runs = [run_once(team, seed, config) for seed in seeds]
    aligned = odometry_best_aligned(team)
    ours = [e for run in runs for e in run.ours]
    paper = [e for run in runs for e in run.paper]
    result = figures(ours) | {
        "trials": len(runs),
        "rms_by_trial_m": [figures(run.ours)["rms_m"] for run in runs],
        "pairs": {" ".join(pair): figures([e for e in ours if e.pair == pair]) for pair in team.score_s},
        "paper_scheme": figures(paper) | {"rms_by_trial_m": [figures(r.paper)["rms_m"] for r in runs]},
        "times_better_than_paper": figures(paper)["rms_m"] / figures(ours)["rms_m"],
        "times_better_than_paper_in_the_median_trial": float(
            np.median([figures(run.paper)["rms_m"] / figures(run.ours)["rms_m"] for run in runs])
        ),
        "with_default_drift": figures([e for run in runs for e in run.default_noise]),
        "odometry_alone_best_aligned": figures(aligned),
        "learned_drift": {
            name: _learned(runs, name, config.localization.odometry_noise) for name in sequences
        },
        "suspects": sorted({name for run in runs for name in run.suspects}),
        "bearings": int(_median(runs, "bearings")),
        "ranges": int(_median(runs, "ranges")),
        "odometry": estimate,
        "mounting_deg": dict(team.mounting_deg),
        "seconds_scored": {
            " ".join(pair): float(np.ptp(times)) if len(times) else 0.0
            for pair, times in team.score_s.items()
        },
    }
    if picture is not None:
        draw_flights(team, runs[0].ours, runs[0].paper, aligned, picture)
    return result


def run_euroc_mh(
    data: Path,
    seeds: Sequence[int] = range(5),
    config: EurocConfig | None = None,
    picture: Path | None = None,
) -> dict[str, Any]:
    """MH_01, MH_03, MH_05 with monocular visual-inertial odometry.

    Args:
        data: Folder that holds ``euroc_vio``.
        seeds: Of the radio, one run each.
        config: Options.
        picture: Where to draw; nowhere if None.

    Raises:
        InputError: A file is missing or damaged.
    """
    flown = ("MH_01", "MH_03", "MH_05")
    return run_team(data, flown, "vio_mono", seeds, config or EurocConfig(), picture)


def run_euroc_v1(
    data: Path,
    seeds: Sequence[int] = range(5),
    config: EurocConfig | None = None,
    picture: Path | None = None,
) -> dict[str, Any]:
    """V1_01, V1_02, V1_03 with key frames of monocular SLAM; arguments as ``run_euroc_mh``."""
    flown = ("V1_01", "V1_02", "V1_03")
    return run_team(data, flown, "vislam_mono_run0", seeds, config or EurocConfig(), picture)
