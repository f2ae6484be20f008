"""``mulan fleet soak``: a fleet on loopback through loss, jitter and kills."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import tyro
from rich.table import Table

from mulan.cli.progress import console
from mulan.fleet.soak import SoakConfig, soak
from mulan.mission.bag_writer import write_mission


@dataclass(frozen=True)
class Options:
    """A base station and robots as separate processes on a bad link, some of them killed; what was lost?"""

    out: Path
    """Folder to write; metrics.json lies in it."""
    bag: Path | None = None
    """Mission the robots replay; without it three simulated robots in a rendered room."""
    minutes: float = SoakConfig.minutes
    """How long; the bag is replayed in 85 % of it, slower or faster than it was recorded."""
    loss: float = SoakConfig.loss
    """Messages lost, each way."""
    jitter_s: float = SoakConfig.jitter_s
    """Random delay, each way, up to this."""
    duplicate: float = SoakConfig.duplicate
    """Messages that come twice."""
    robot_away_s: float = SoakConfig.robot_away_s
    """The second robot is killed for this long, or a sixth of the test if that is shorter."""
    base_kills: int = SoakConfig.base_kills
    """How often the base station is killed."""
    localize: bool = True
    """Localize from the received bag and from the undisturbed one, and compare."""
    seed: int = 0
    """Source of all randomness."""


def simulated_bag(folder: Path, seed: int) -> Path:
    """The mission of three robots in the built-in room, with small photographs."""
    from mulan.simulation.from_scene import SceneMissionConfig, simulate_from_scene

    bag = folder / "undisturbed.mcap"
    if not bag.exists():
        config = SceneMissionConfig(
            robots=3, photos_per_robot=16, held_out=0, width=96, height=72, samples_per_pixel=8, seed=seed
        )
        write_mission(simulate_from_scene(config), bag)
    return bag


def main(arguments: Sequence[str]) -> int:
    """Run the test and tell what was lost."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet soak")
    bag = options.bag
    if bag is None:
        console.print("Photographing the room")
        options.out.mkdir(parents=True, exist_ok=True)
        bag = simulated_bag(options.out, options.seed)
    chosen = {f.name: getattr(options, f.name) for f in fields(options) if f.name != "bag"}
    metrics = soak(SoakConfig(bag=bag, **chosen), lambda text: console.print(f"[dim]{text}[/]"))
    table = Table(box=None, show_header=False, padding=(0, 2))
    for name, value in metrics["messages"].items():
        table.add_row(name.replace("_", " "), str(value))
    for who, count in metrics["restarts_survived"].items():
        table.add_row(f"restarts of {who}", str(count))
    for pair, value in metrics["coordination_bytes_per_mission_s_and_pair"].items():
        table.add_row(f"coordination {pair}", f"{value / 1e3:.2f} kB/s")
    console.print(table)
    console.print(f"Metrics: [bold]{options.out / 'metrics.json'}[/]")
    return 0 if metrics["messages"]["lost"] == 0 else 1
