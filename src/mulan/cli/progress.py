"""Progress bars for everything over two seconds."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from mulan.reconstruction.torchrun import is_leader

console = Console(highlight=False, soft_wrap=True, quiet=not is_leader())

ReportProgress = Callable[[float, float, str], None]
"""Called with what is done, the total, and a few words on the latest state."""

_PLAIN_INTERVAL_S = 20.0  # how often a log file without a terminal hears of a long stage


def _columns() -> tuple:
    return (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=12),
        TimeElapsedColumn(),
        TextColumn("ETA"),
        TimeRemainingColumn(compact=True),
        TextColumn("[dim]{task.fields[text]}"),
    )


def _plain(title: str) -> ReportProgress:
    console.print(f"{title} ...")
    began = last = time.monotonic()

    def report(done: float, total: float, text: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > _PLAIN_INTERVAL_S:
            last = now
            share = done / max(total, 1e-9)
            left = f"ETA {timedelta(seconds=round((now - began) * (1 / share - 1)))}, " if share > 0 else ""
            console.print(f"  {title}: {100 * share:.0f} %, {left}{text}".rstrip(", "))

    return report


@contextmanager
def progress_stages() -> Iterator[Callable[[str], ReportProgress]]:
    """One live display for several stages in turn: call it with a title, follow the callback it gives.

    Beginning a stage ends the one before. Where the output is not a terminal, plain lines are printed.
    """
    if not console.is_terminal:
        yield _plain
        return
    with Progress(*_columns(), console=console) as progress:

        def begin(title: str) -> ReportProgress:
            finish()
            task = progress.add_task(title, total=None, text="")
            return lambda done, total, text: progress.update(task, completed=done, total=total, text=text)

        def finish() -> None:
            for task in progress.tasks:
                if not task.finished:
                    progress.update(task.id, total=1, completed=1)

        yield begin
        finish()


@contextmanager
def progress_bar(title: str) -> Iterator[ReportProgress]:
    """The display of a single stage."""
    with progress_stages() as begin:
        yield begin(title)
