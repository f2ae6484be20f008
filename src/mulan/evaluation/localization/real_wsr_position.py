"""The moving robot of every WSR run placed by its real bearings to radios whose places are given."""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.evaluation.aoa.folder import link_sets
from mulan.evaluation.localization.bearing_resection import (
    PlanePosterior,
    ResectionConfig,
    SeenRadio,
    resection,
)
from mulan.evaluation.localization.track_score import COVERED
from mulan.evaluation.localization.wsr_picture import draw_positions
from mulan.geometry import se3
from mulan.wireless.azimuth_density import azimuth_mixture
from mulan.wireless.bearing import BearingConfig
from mulan.wireless.link_bearing import (
    HEADING_FRAME_YAW_SIGMA_RAD,
    T265_FRAME_YAW_SIGMA_RAD,
    DisplacementSource,
    displacement_track,
    link_bearing,
)
from mulan.wireless.recordings.wsr import WsrRun, read_wsr_run

HEADING = (
    "The robot was set down along the motion-capture axes and its odometry starts with heading zero. The "
    "authors' toolbox takes that heading as right and compares azimuths directly; here it is a prior with "
    "the sigma found on LOS_Set_A, and integrated out"
)
_FRAME_SIGMA_RAD = {
    DisplacementSource.T265: T265_FRAME_YAW_SIGMA_RAD,
    DisplacementSource.T265_WHEELS: HEADING_FRAME_YAW_SIGMA_RAD,
}
PUBLISHED_M = {"los": 0.5, "nlos": 0.9}
"""Median position errors the authors' toolbox reports."""


@dataclass(frozen=True)
class WsrPositionConfig:
    """How runs are placed."""

    bearings: BearingConfig = field(default_factory=BearingConfig)
    """The estimator of the bearings."""
    resection: ResectionConfig = field(default_factory=ResectionConfig)
    """What is known before them."""
    workers: int = 1
    """Processes, of one thread each."""


@dataclass(frozen=True)
class PlacedRun:
    """One run placed; ``squared`` is the truth's Mahalanobis length, ``ellipse`` and ``level`` its levels."""

    set: str
    run: str
    source: DisplacementSource
    links: int
    estimate_m: Float[NDArray, "2"]
    true_m: Float[NDArray, "2"]
    squared: float
    ellipse: float
    level: float
    ellipse_68_m2: Float[NDArray, "2 2"]

    @property
    def error_m(self) -> float:
        """Distance from the truth."""
        return float(np.linalg.norm(self.estimate_m - self.true_m))


def posterior_of_run(
    run: WsrRun, source: DisplacementSource, config: WsrPositionConfig
) -> tuple[PlanePosterior, int] | None:
    """Where the run started, and of how many bearings; None if no link gave one. No truth is read.

    Raises:
        InputError: A link's recording is dead or cannot be paired.
    """
    track = displacement_track(run, source)
    start = se3.interpolate(track.time_s, track.T_odom_body, np.array([run.motion_s[0]]))[0, :2, 3]
    seen = []
    for link in run.links:
        bearing = link_bearing(run, link, source, config.bearings)
        if bearing is None:
            continue
        origin = bearing.T_odom_body[:3, 3] if bearing.origin_odom_m is None else bearing.origin_odom_m
        seen.append(SeenRadio(azimuth_mixture(bearing), origin[:2] - start, link.source_position_m[:2]))
    if not seen:
        return None
    return resection(seen, _FRAME_SIGMA_RAD[source], config.resection), len(seen)


def place_run(task: tuple[str, Path, WsrPositionConfig]) -> list[PlacedRun]:
    """One file, by both displacement sources; a source without any bearing is left out and told."""
    set_name, path, config = task
    run = read_wsr_run(path)
    true_m = run.start_m[:2]
    placed = []
    for source in _FRAME_SIGMA_RAD:
        found = posterior_of_run(run, source, config)
        if found is None:
            continue
        posterior, links = found
        placed.append(
            PlacedRun(
                set_name,
                run.name,
                source,
                links,
                posterior.nearest_m,
                true_m,
                posterior.squared_length(true_m),
                posterior.ellipse_level_of(true_m),
                posterior.level_of(true_m),
                posterior.ellipse_m2(0.68),
            )
        )
    return placed


def _placed(tasks: Sequence[tuple[str, Path, WsrPositionConfig]], workers: int) -> Iterator[list[PlacedRun]]:
    if workers <= 1:
        yield from map(place_run, tasks)
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield from pool.map(place_run, tasks)


def _figures(runs: Sequence[PlacedRun]) -> dict[str, Any]:
    error = np.array([run.error_m for run in runs])
    squared = np.array([run.squared for run in runs])
    result: dict[str, Any] = {
        "runs": len(runs),
        "median_m": float(np.median(error)),
        "mean_m": float(error.mean()),
        "rms_m": float(np.sqrt((error**2).mean())),
        "worst_m": float(error.max()),
        "nees_per_dof": float(squared.mean() / 2),
    }
    for name, bound in COVERED.items():
        share = int(name[-2:]) / 100
        result[name] = float(np.mean([run.ellipse <= share for run in runs]))
        result[f"density_{name}"] = float(np.mean([run.level <= share for run in runs]))
        result[f"gaussian_{name}"] = float((squared <= bound).mean())
    return result


def run_wsr_position(
    data: Path, config: WsrPositionConfig | None = None, picture: Path | None = None
) -> dict[str, Any]:
    """Every run of every set.

    ``coverage`` counts ellipses that hold 68 and 95 % of the posterior, ``density_coverage`` highest-density
    regions, ``gaussian_coverage`` ellipses of a Gaussian with the posterior's mean and covariance.

    Args:
        data: Folder that holds ``wsr_aoa``.
        config: Options.
        picture: Where to draw; nowhere if None.

    Raises:
        InputError: A file is missing or damaged.
    """
    config = config or WsrPositionConfig()
    sets = link_sets(data / "wsr_aoa")
    tasks = [(s.name, path, config) for s in sets for path in s.runs]
    runs = [run for part in _placed(tasks, config.workers) for run in part]
    if not runs:
        raise InputError(data / "wsr_aoa", "runs", "none has a bearing", "restore them from the source")
    result: dict[str, Any] = {"heading": HEADING, "published_median_m": PUBLISHED_M, "files": len(tasks)}
    for source in _FRAME_SIGMA_RAD:
        of_source = [run for run in runs if run.source is source]
        part: dict[str, Any] = {}
        for s in sets:
            of_set = [run for run in of_source if run.set == s.name]
            if of_set:
                part[s.name] = _figures(of_set) | {"bearings_a_run": max(run.links for run in of_set)}
        fixable = [run for run in of_source if run.set.startswith("NLOS") and run.links >= 2]
        if fixable:
            part["nlos_with_two_or_more_bearings"] = _figures(fixable)
        result[source.value] = part
    if picture is not None:
        draw_positions(runs, picture)
    return result
