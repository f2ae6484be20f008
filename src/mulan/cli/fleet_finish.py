"""``mulan fleet finish``: the bag of a killed base station, put in order."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mulan.cli.progress import console
from mulan.fleet.journal import finish


@dataclass(frozen=True)
class Options:
    """Write the end that a killed base station could not, so that every reader opens the bag."""

    bag: Annotated[Path, tyro.conf.Positional]
    """The bag."""


def main(arguments: Sequence[str]) -> int:
    """Finish one bag."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet finish")
    count = finish(options.bag)
    console.print(f"Bag: [bold]{options.bag}[/] ({count} messages)")
    console.print(f"Next: [cyan]mulan run {options.bag} --out runs/{options.bag.stem}[/]")
    return 0
