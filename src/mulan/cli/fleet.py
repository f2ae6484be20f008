"""``mulan fleet``: robots and a base station over the network."""

from collections.abc import Sequence

from rich.table import Table

from mulan.cli import fleet_base, fleet_finish, fleet_keys, fleet_robot, fleet_soak
from mulan.cli.progress import console
from mulan.errors import InputError

PARTS = {
    "base": ("Receive from robots, write the mission bag, acknowledge.", fleet_base.main),
    "robot": ("Send what one robot of a bag recorded, in real time or faster.", fleet_robot.main),
    "keys": ("Make the certificates by which base station and robots know each other.", fleet_keys.main),
    "soak": ("Loss, jitter and kills on loopback; says what was lost.", fleet_soak.main),
    "finish": ("Put the bag of a killed base station in order.", fleet_finish.main),
}


def main(arguments: Sequence[str]) -> int:
    """Run one part."""
    if not arguments or arguments[0] in ("-h", "--help"):
        table = Table(box=None, show_header=False, padding=(0, 2))
        for name, (purpose, _) in PARTS.items():
            table.add_row(f"[cyan]mulan fleet {name}[/]", purpose)
        console.print(table)
        return 0
    name, *rest = arguments
    if name not in PARTS:
        remedy = f"choose from {', '.join(PARTS)}"
        raise InputError("mulan fleet", f"part '{name}'", "is unknown", remedy)
    return PARTS[name][1](rest)
