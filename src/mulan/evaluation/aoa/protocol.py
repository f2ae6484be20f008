"""The protocol: every link of every set, by every displacement source, once."""

import csv
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from mulan.errors import InputError
from mulan.evaluation.aoa.folder import LinkSet
from mulan.evaluation.aoa.scored_link import (
    FailedLink,
    MeasuredLink,
    ScoredLink,
    measured_link,
    timed_bearing,
)
from mulan.mission.run_folder import write_atomically
from mulan.wireless.bearing import BearingConfig
from mulan.wireless.link_bearing import DisplacementSource
from mulan.wireless.recordings.wsr import read_wsr_run

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class AoaProtocolConfig:
    """Which links are measured and how."""

    bearings: BearingConfig = field(default_factory=BearingConfig)
    """The estimator."""
    sources: tuple[DisplacementSource, ...] = (DisplacementSource.MOCAP, DisplacementSource.T265)
    """Where the moving antenna's path comes from."""
    workers: int = 2
    """Processes, of one thread each."""


@dataclass(frozen=True)
class Task:
    """One file."""

    set: LinkSet
    path: Path
    config: AoaProtocolConfig


Result = tuple[list[MeasuredLink], list[FailedLink]]


def measured_run(task: Task) -> Result:
    """All links of one file; what fails is told, not raised."""
    measured: list[MeasuredLink] = []
    failed: list[FailedLink] = []
    try:
        run = read_wsr_run(task.path)
    except InputError as error:
        return [], [FailedLink(task.set.name, task.path.stem, "", "", str(error))]
    for link in run.links:
        row = task.set.reference.get((run.name, link.name))
        for source in task.config.sources:
            label = (task.set.name, run.name, link.name, source.value)
            try:
                bearing, milliseconds = timed_bearing(run, link, source, task.config.bearings)
            except (InputError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
                failed.append(FailedLink(*label, f"{type(error).__name__}: {error}"))
                continue
            if bearing is None:
                failed.append(
                    FailedLink(*label, "too few packets, or the antenna's path was a straight line")
                )
                continue
            reported = row.reported.get(source) if row else None
            measured.append(measured_link(task.set.name, run, link, source, bearing, milliseconds, reported))
    return measured, failed


def _results(tasks: Sequence[Task], workers: int) -> Iterator[tuple[Task, Result]]:
    if workers <= 1 or len(tasks) == 1:
        for task in tasks:
            yield task, measured_run(task)
        return
    # the threads of a worker's array library are fixed when it is imported, so by its environment
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            waiting = {pool.submit(measured_run, task): task for task in tasks}
            for done in as_completed(waiting):
                yield waiting[done], done.result()
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def measure_links(
    sets: Sequence[LinkSet],
    config: AoaProtocolConfig,
    progress: Callable[[float, float, str], None] | None = None,
) -> Result:
    """Every link, in the order of sets, files and links whatever the number of workers.

    Args:
        sets: What to measure.
        config: How.
        progress: Called with (files done, files in all, the last one's name).
    """
    tasks = [Task(link_set, path, config) for link_set in sets for path in link_set.runs]
    by_file: dict[Path, Result] = {}
    for task, result in _results(tasks, config.workers):
        by_file[task.path] = result
        if progress is not None:
            progress(len(by_file), len(tasks), f"{task.set.name} {task.path.stem}")
    measured = [link for task in tasks for link in by_file[task.path][0]]
    return measured, [link for task in tasks for link in by_file[task.path][1]]


def write_links(links: Sequence[ScoredLink], path: Path) -> None:
    """One row a link."""

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="") as lines:
            writer = csv.DictWriter(lines, list(ScoredLink.__dataclass_fields__), lineterminator="\n")
            writer.writeheader()
            for link in links:
                writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in link.row().items()})

    write_atomically(path, write)
