"""What was found to be wrong with the packets that bearings come from."""

from collections.abc import Iterable

from rich.markup import escape

from mulan.cli.progress import console
from mulan.wireless.types import Bearing


def print_faults(bearings: Iterable[Bearing]) -> None:
    """One line for each finding, once."""
    for fault in dict.fromkeys(str(fault) for bearing in bearings for fault in bearing.faults):
        console.print(f"[yellow]warning[/] {escape(fault)}")
