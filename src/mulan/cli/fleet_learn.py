"""``mulan fleet learn``: localization and training from a bag that is still being written."""

import fcntl
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Annotated

import tyro
from rich.markup import escape

from mulan.cli import fleet_base
from mulan.cli.progress import console
from mulan.errors import InputError
from mulan.fleet.learner import LearnConfig, Learner
from mulan.mission.run_folder import RunFolder

_PATIENCE_S = 30.0  # for a learner whose base station was killed to notice and let go of the run


@dataclass(frozen=True)
class Options:
    """Localize and learn from the bag a base station is writing, until it is finished.

    Stopped at any moment, the same command goes on where it was.
    """

    bag: Annotated[Path, tyro.conf.Positional]
    """Bag of the base station; it may come later."""
    out: Path
    """Run folder to write: 'mulan view' and 'mulan report' open it at any time."""
    learn: Annotated[LearnConfig, tyro.conf.arg(name="")] = field(default_factory=LearnConfig)
    """How."""


@dataclass(frozen=True)
class BaseOptions(fleet_base.Options):
    """Receive what robots send, write it to a bag, and acknowledge only what is on the disk.

    Meanwhile localize and learn, and tell the robots where they are and where to go.
    """

    learn: LearnConfig = field(default_factory=LearnConfig)
    """How to localize and learn."""


def learn(bag: Path, out: Path, config: LearnConfig, stop: Callable[[], bool]) -> bool:
    """Follow a bag and write the report when it is finished; whether it came to that.

    Raises:
        InputError: See :class:`Learner`; or another learner writes to the run.
    """
    from mulan.report.page import write_report  # seconds to load, and wanted only at the end

    run = RunFolder(out)
    run.check_writable()
    with _alone(run):
        learner = Learner(bag, run, config, lambda text: console.print(f"[dim]{escape(text)}[/]"))
        run.record_config("fleet learn", {"bag": str(bag)} | asdict(config))
        if not learner.follow(stop):
            return False
        if run.transforms.exists():
            console.print(f"Report: [bold]{write_report(run)}[/]")
        return True


def start_learner(bag: Path, out: Path, config: LearnConfig) -> BaseProcess:
    """A learner as a process of its own, so that receiving never waits for it; it ends with its parent."""
    process = multiprocessing.get_context("spawn").Process(
        target=_work_beside, args=(bag, out, config), name="learner", daemon=True
    )
    process.start()
    return process


def _work_beside(bag: Path, out: Path, config: LearnConfig) -> None:
    # Ctrl-C reaches the whole group; the base station decides what it means
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asked = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: asked.set())
    parent = multiprocessing.parent_process()
    try:
        learn(bag, out, config, lambda: asked.is_set() or (parent is not None and not parent.is_alive()))
    except InputError as error:
        console.print("[red bold]error[/]", escape(f"learning stopped: {error}"))


@contextmanager
def _alone(run: RunFolder) -> Iterator[None]:
    """Hold a run against other learners."""
    path = run.root / ".learner.lock"
    file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        until_s = time.monotonic() + _PATIENCE_S
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except OSError:
                if time.monotonic() > until_s:
                    remedy = "stop that one or choose another run folder"
                    raise InputError(run.root, "run", "is written by another learner", remedy) from None
                time.sleep(0.2)
        yield
    finally:
        os.close(file)


def main(arguments: Sequence[str]) -> int:
    """Learn until the bag is finished, or until interrupted."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet learn")
    stop = fleet_base.stop_on_signals()
    if not learn(options.bag, options.out, options.learn, stop.is_set):
        console.print("Stopped; the same command goes on where it was")
        return 0
    console.print(f"Next: [cyan]mulan view {options.out}[/]")
    return 0
