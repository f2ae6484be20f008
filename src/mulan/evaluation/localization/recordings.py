"""The real recordings: which there are, and measuring several at a time."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from mulan.errors import InputError
from mulan.evaluation.localization.cases import Progress
from mulan.evaluation.localization.real_euroc import run_euroc_mh, run_euroc_v1
from mulan.evaluation.localization.real_uwb import run_uwb_indoor_chemnitz, run_uwb_murp, run_uwb_planar
from mulan.evaluation.localization.real_wsr_position import run_wsr_position


class _Measure(Protocol):
    def __call__(self, data: Path, *, picture: Path | None) -> dict[str, Any]: ...


# the longest first
_RECORDINGS: dict[str, tuple[str, _Measure]] = {
    "euroc_mh": ("euroc_vio", run_euroc_mh),
    "euroc_v1": ("euroc_vio", run_euroc_v1),
    "wsr_position": ("wsr_aoa", run_wsr_position),
    "uwb_murp": ("uwb_murp", run_uwb_murp),
    "uwb_planar": ("uwb_planar", run_uwb_planar),
    "uwb_indoor_chemnitz": ("uwb_indoor_chemnitz", run_uwb_indoor_chemnitz),
}
RECORDINGS = tuple(_RECORDINGS)


def chosen_recordings(names: str) -> tuple[str, ...]:
    """Recordings named in a list separated by commas; none named means all.

    Raises:
        InputError: One is unknown.
    """
    chosen = tuple(name.strip() for name in names.split(",") if name.strip())
    for name in chosen:
        if name not in _RECORDINGS:
            raise InputError(
                "--recordings", f"'{name}'", "is unknown", f"choose from {', '.join(RECORDINGS)}"
            )
    return chosen or RECORDINGS


def measure(name: str, data: Path, pictures: Path) -> dict[str, Any] | str:
    """One recording's line of ``metrics.json``; a sentence where it does not lie in ``data``."""
    folder, run = _RECORDINGS[name]
    if not (data / folder).is_dir():
        return f"not available: there is no {folder} in {data}"
    return run(data, picture=pictures / f"{name}.png")


def measured_recordings(
    names: Sequence[str], data: Path, pictures: Path, workers: int, progress: Progress
) -> Iterator[tuple[str, dict[str, Any] | str]]:
    """Every recording named, as each is done.

    Raises:
        InputError: A recording cannot be read; those already done were given before.
    """
    progress(0, max(len(names), 1), ", ".join(names[:workers]))
    work = partial(measure, data=data, pictures=pictures)
    if workers <= 1:
        for done, name in enumerate(names):
            progress(done, len(names), name)
            yield name, work(name)
        return
    # a fresh interpreter each: a fork would copy locks held by threads of the parent
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        jobs = {pool.submit(work, name): name for name in names}
        for done, job in enumerate(as_completed(jobs)):
            yield jobs[job], job.result()
            progress(done + 1, len(names), jobs[job])
