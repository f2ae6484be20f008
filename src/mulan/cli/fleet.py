"""``mulan fleet``: robots and a base station over the network."""

import importlib
from collections.abc import Sequence

from rich.table import Table

from mulan.cli.progress import console
from mulan.errors import InputError

PARTS = {
    "base": "Receive from robots, write the mission bag, acknowledge; with --run localize and learn.",
    "learn": "Localize and learn from the bag a base station is writing.",
    "robot": "Send what one robot of a bag, or of a simulated world, records.",
    "world": "A simulated world whose robots go to the goals they are sent.",
    "demo": "Three simulated robots, a base station that learns and a page, on this machine.",
    "keys": "Make the certificates by which base station and robots know each other.",
    "soak": "Loss, jitter and kills on loopback; says what was lost.",
    "finish": "Put the bag of a killed base station in order.",
}


def main(arguments: Sequence[str]) -> int:
    """Run one part."""
    if not arguments or arguments[0] in ("-h", "--help"):
        table = Table(box=None, show_header=False, padding=(0, 2))
        for name, purpose in PARTS.items():
            table.add_row(f"[cyan]mulan fleet {name}[/]", purpose)
        console.print(table)
        return 0
    name, *rest = arguments
    if name not in PARTS:
        remedy = f"choose from {', '.join(PARTS)}"
        raise InputError("mulan fleet", f"part '{name}'", "is unknown", remedy)
    # only this part's module: a robot must not load what the soak test localizes with
    return importlib.import_module(f"mulan.cli.fleet_{name}").main(rest)
