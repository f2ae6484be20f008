"""The trolley of uwb_planar tracked by its ranges: eight anchors, three tags, no odometry."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.localization.site_tracking import (
    SITE,
    Antenna,
    placed,
    planar,
    site_keyframes,
    solved,
    tracking_graph,
    wandering_keyframes,
)
from mulan.evaluation.localization.track_score import TrackErrors, track_errors, track_figures
from mulan.evaluation.uwb.protocol import read_planar, time_halves
from mulan.geometry.camera import PinholeCamera
from mulan.localization.graph import LocalizationConfig
from mulan.mission.types import OdometryTrack, RangeTrack, RobotLog
from mulan.wireless.range_fit import RangeFitConfig, fit_range_model
from mulan.wireless.range_model import RangeModel
from mulan.wireless.ranging import RangingConfig, thin_ranges
from mulan.wireless.recordings.uwb_planar import PlanarRun
from mulan.wireless.recordings.uwb_samples import RangeSamples
from mulan.wireless.types import Range

ROBOT = "trolley"
_NO_CAMERA = PinholeCamera(1, 1, 1.0, 1.0, 0.5, 0.5)
_FITTED_EVERY = 10  # 100 Hz to 10 Hz: neighbours share their errors
_UNCALIBRATED_SIGMA_M = 0.1


@dataclass(frozen=True)
class SiteTrackConfig:
    """How a robot between fixed antennas is tracked."""

    rate_hz: float = 2.0
    """Poses a second; the ranges of one such window are voted into one a link."""
    walk_m_per_sqrt_s: float = 0.5
    """Random walk of a robot without odometry, metres after one second."""
    turn_rad_per_sqrt_s: float = 0.7
    """Its turning, radians after one second."""
    fit: RangeFitConfig = field(default_factory=RangeFitConfig)
    """How error laws are fitted to the training part."""
    localization: LocalizationConfig = field(
        default_factory=lambda: LocalizationConfig(common_floor_sigma_m=0.02)
    )
    """Graph options; the robots roll on one floor, which level antennas cannot see."""


def as_logs(samples: RangeSamples, sigma_m: float) -> list[RobotLog]:
    """Each device as a robot that heard the others, so that ranges are thinned as a mission's are."""
    names = list(dict.fromkeys(name for link in samples.links for name in link))
    still = OdometryTrack(np.array([0.0]), np.eye(4)[None], None)
    heard: dict[str, dict[str, RangeTrack]] = {name: {} for name in names}
    for number, (first, second) in enumerate(samples.links):
        rows = samples.link == number
        if rows.any():
            sigma = np.full(int(rows.sum()), sigma_m)
            heard[first][second] = RangeTrack(second, samples.time_s[rows], samples.range_m[rows], sigma)
    return [
        RobotLog(name, _NO_CAMERA, np.eye(4), np.zeros(3), np.zeros(3), (), still, {}, tracks)
        for name, tracks in heard.items()
    ]


def thinned(
    samples: RangeSamples, model: RangeModel | None, rate_hz: float, free: bool = True
) -> list[Range]:
    """Ranges of all links at a steady rate, calibrated by a model fitted elsewhere or as they come.

    Args:
        samples: Ranges; their truth is not read.
        model: Error laws, or None.
        rate_hz: Windows a second.
        free: The robot has no odometry and may move from window to window.
    """
    logs = as_logs(samples, _UNCALIBRATED_SIGMA_M)
    if model is None:
        return thin_ranges(logs, RangingConfig(rate_hz=rate_hz))
    # a robot free to move from window to window averages nothing over time: an error that lasts longer than
    # a window must not count against it twice
    if free:
        model = replace(model, correlation_s=min(model.correlation_s, 1 / rate_hz))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.json"
        model.save(path)
        return thin_ranges(logs, RangingConfig(rate_hz=rate_hz, calibration=path))


def epochs(ranges: list[Range], rate_hz: float) -> dict[float, list[Range]]:
    """Ranges by window, keyed by the mean time of the window's."""
    windows: dict[int, list[Range]] = {}
    for r in ranges:
        windows.setdefault(int(np.floor(r.time_s * rate_hz)), []).append(r)
    return {float(np.mean([r.time_s for r in part])): part for _, part in sorted(windows.items())}


def first_guesses(
    antennas: Mapping[str, Antenna], by_time: Mapping[float, list[Range]], fewest: int = 4
) -> Float[NDArray, "n 4 4"]:
    """A pose at each window from its own ranges to fixed antennas, each started at the one before."""
    near: Float[NDArray, "3"] | None = None
    poses = []
    for part in by_time.values():
        if len(part) >= fewest:
            near = placed(antennas, part, {r.time_s: np.eye(4) for r in part}, near)
        poses.append(np.eye(4) if near is None else planar(*near))
    return np.array(poses)


def track_trolley(
    name: str, run: PlanarRun, samples: RangeSamples, model: RangeModel | None, config: SiteTrackConfig
) -> TrackErrors:
    """The trolley's poses from ``samples`` of a run, and their errors.

    The trolley's height is taken from the survey (it rolls on a floor); everything else is estimated.
    """
    floor_m = np.array([0.0, 0.0, float(np.median(run.position_m[:, 2]))])
    antennas = {f"a{i}": Antenna(SITE, at - floor_m) for i, at in enumerate(run.site.anchors_m)}
    antennas |= {f"t{i}": Antenna(ROBOT, at) for i, at in enumerate(run.site.tags_m)}
    ranges = thinned(_sparse(samples), model, config.rate_hz)
    by_time = epochs(ranges, config.rate_hz)
    times = np.array(list(by_time))
    bodies = {
        SITE: site_keyframes(),
        ROBOT: wandering_keyframes(ROBOT, times, config.walk_m_per_sqrt_s, config.turn_rad_per_sqrt_s),
    }
    graph = tracking_graph(bodies, antennas, ranges, config.localization)
    tracked = solved(graph, {ROBOT: first_guesses(antennas, by_time)})[ROBOT]
    true_m = np.stack([np.interp(times, run.time_s, run.position_m[:, k]) for k in (0, 1)], 1)
    true_yaw = np.interp(times, run.time_s, np.unwrap(run.yaw_rad))
    return track_errors(name, tracked, true_m, true_yaw)


def _sparse(samples: RangeSamples) -> RangeSamples:
    instant = np.unique(samples.time_s, return_inverse=True)[1]
    return samples.where(instant % _FITTED_EVERY == 0)


def _widening(run: PlanarRun, half: RangeSamples, config: SiteTrackConfig) -> float:
    """Factor on a track's covariance, from training data alone.

    The links' errors are not independent (they share reflections and the survey). How much that costs shows
    where one quarter is tracked by laws fitted to the other of the same training half.
    """
    quarters = time_halves(half)
    ratios = []
    for number, quarter in enumerate(quarters):
        model = fit_range_model(_sparse(quarters[1 - number]), config.fit)
        ratios.append(track_figures([track_trolley("", run, quarter, model, config)])["nees_per_dof"])
    return float(np.mean(ratios))


def planar_tracks(
    data: Path, config: SiteTrackConfig
) -> tuple[dict[str, list[TrackErrors]], dict[str, list[TrackErrors]]]:
    """Tracks by run, with a calibration fitted to other times or another run, and without one.

    The moving run's halves are calibrated by each other; the runs at rest by the moving run.

    Raises:
        InputError: A file is missing or damaged.
    """
    runs = read_planar(data / "uwb_planar")
    moving = runs["dynamic"]
    halves = time_halves(moving.samples)
    models = [fit_range_model(_sparse(half), config.fit) for half in halves]
    whole = fit_range_model(_sparse(moving.samples), config.fit)
    widening = [_widening(moving, half, config) for half in halves]
    calibrated: dict[str, list[TrackErrors]] = {"dynamic": []}
    plain: dict[str, list[TrackErrors]] = {"dynamic": []}
    for number, half in enumerate(halves):
        name = f"dynamic, half {number + 1}"
        track = track_trolley(name, moving, half, models[1 - number], config)
        calibrated["dynamic"].append(replace(track, covariance=widening[1 - number] * track.covariance))
        plain["dynamic"].append(track_trolley(name, moving, half, None, config))
    for name in ("static_deg_0", "static_deg_60"):
        track = track_trolley(name, runs[name], runs[name].samples, whole, config)
        calibrated[name] = [replace(track, covariance=float(np.mean(widening)) * track.covariance)]
        plain[name] = [track_trolley(name, runs[name], runs[name].samples, None, config)]
    return calibrated, plain
