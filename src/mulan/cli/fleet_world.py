"""``mulan fleet world``: a simulated world that several robots' programs share."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.markup import escape

from mulan.cli.fleet_base import stop_on_signals
from mulan.cli.progress import console
from mulan.fleet.simulated_world import SimulatedWorld, WorldConfig


@dataclass(frozen=True)
class Options:
    """A simulated world: it moves its robots where their programs want to go, and records for them."""

    folder: Annotated[Path, tyro.conf.Positional]
    """New folder through which the robots' programs and the world talk."""
    world: Annotated[WorldConfig, tyro.conf.arg(name="")] = field(default_factory=WorldConfig)
    """The world."""


def main(arguments: Sequence[str]) -> int:
    """Run the world until its time is over."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet world")
    stop = stop_on_signals()
    world = SimulatedWorld(options.folder, options.world, lambda text: console.print(escape(text)))
    console.print(
        f"There is a world in [bold]{options.folder}[/] for {', '.join(world.obeyed)}; start each with"
        f" [cyan]mulan fleet robot --simulate {options.folder} --name NAME --spool NAME.spool[/]"
    )
    world.run(stop.is_set)
    goals = ", ".join(f"{name} {count}" for name, count in world.obeyed.items())
    console.print(f"{world.legs} legs; goals gone to: {goals}")
    return 0
