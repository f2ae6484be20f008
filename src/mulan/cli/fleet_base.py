"""``mulan fleet base``: the base station."""

import signal
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from rich.markup import escape

from mulan.cli.progress import console
from mulan.fleet.base_station import BaseConfig, BaseStation
from mulan.fleet.growing_bag import GrowingBag
from mulan.fleet.orders import Orders
from mulan.fleet.status import base_status
from mulan.mission.run_folder import RunFolder, write_json


@dataclass(frozen=True)
class Options:
    """Receive what robots send, write it to a bag, and acknowledge only what is on the disk.

    With --run also localize and learn meanwhile, and tell the robots where they are and where to go.
    """

    base: Annotated[BaseConfig, tyro.conf.arg(name="")]
    """The station."""
    run: Path | None = None
    """Run folder in which a process beside this one localizes and learns from the bag as it grows; with it
    --help shows more options."""
    status: Path | None = None
    """JSON file of figures, written anew every second."""


def stop_on_signals() -> threading.Event:
    """Set by the first SIGTERM or SIGINT; a second one ends the process at once."""
    stop = threading.Event()

    def ask(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        stop.set()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, ask)
    return stop


def main(arguments: Sequence[str]) -> int:
    """Serve until stopped."""
    start = None
    if any(argument.partition("=")[0] == "--run" for argument in arguments):
        # a base station that only receives must not load what others learn with
        from mulan.cli import fleet_learn

        options = tyro.cli(fleet_learn.BaseOptions, args=arguments, prog="mulan fleet base")
        start = partial(fleet_learn.start_learner, config=options.learn)
    else:
        options = tyro.cli(Options, args=arguments, prog="mulan fleet base")
    stop = stop_on_signals()
    base = BaseStation(options.base, tell=lambda text: console.print(escape(text)))
    known = options.base.ingest.robots
    console.print(
        f"Listening at [bold]{options.base.link.endpoint}[/] for {', '.join(known) or 'any robot'};"
        f" writing {options.base.out} ({base.journal.messages} messages so far). Stop with Ctrl-C."
    )
    learner = orders = None
    if start is not None and options.run is not None:
        learner = start(options.base.out, options.run)
        orders = Orders(base, RunFolder(options.run), lambda text: console.print(escape(text)))
        console.print(f"Learning in [bold]{options.run}[/]; to see it: [cyan]mulan view {options.run}[/]")
    missed = False
    while not stop.wait(1.0):
        if learner is not None and not learner.is_alive() and not missed:
            missed = True
            console.print(
                f"[yellow]The learner has ended;[/] receiving goes on. To learn again:"
                f" [cyan]mulan fleet learn {options.base.out} --out {options.run}[/]"
            )
        if options.status is not None:
            write_json(options.status, base_status(base))
    if orders is not None:
        orders.close()
    base.close()
    if options.status is not None:
        write_json(options.status, base_status(base))
    console.print(f"Bag: [bold]{options.base.out}[/] ({base.journal.messages} messages)")
    if learner is not None:
        console.print("The learner settles; Ctrl-C once more leaves the rest to 'mulan fleet learn'")
        if not GrowingBag(options.base.out).finished:
            learner.terminate()  # without an end of the bag it would wait for one
        learner.join()
        console.print(f"Next: [cyan]mulan view {options.run}[/]")
        return 0
    console.print(f"Next: [cyan]mulan run {options.base.out} --out runs/{options.base.out.stem}[/]")
    return 0
