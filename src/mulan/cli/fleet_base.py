"""``mulan fleet base``: the base station."""

import signal
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.markup import escape

from mulan.cli.progress import console
from mulan.fleet.base_station import BaseConfig, BaseStation
from mulan.fleet.status import base_status
from mulan.mission.run_folder import write_json


@dataclass(frozen=True)
class Options:
    """Receive what robots send, write it to a bag, and acknowledge only what is on the disk."""

    base: Annotated[BaseConfig, tyro.conf.arg(name="")]
    """The station."""
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
    options = tyro.cli(Options, args=arguments, prog="mulan fleet base")
    stop = stop_on_signals()
    base = BaseStation(options.base, tell=lambda text: console.print(escape(text)))
    known = options.base.ingest.robots
    console.print(
        f"Listening at [bold]{options.base.link.endpoint}[/] for {', '.join(known) or 'any robot'};"
        f" writing {options.base.out} ({base.journal.messages} messages so far). Stop with Ctrl-C."
    )
    while not stop.wait(1.0):
        if options.status is not None:
            write_json(options.status, base_status(base))
    base.close()
    if options.status is not None:
        write_json(options.status, base_status(base))
    console.print(f"Bag: [bold]{options.base.out}[/] ({base.journal.messages} messages)")
    console.print(f"Next: [cyan]mulan run {options.base.out} --out runs/{options.base.out.stem}[/]")
    return 0
