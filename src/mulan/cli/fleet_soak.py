"""``mulan fleet soak``: a fleet on loopback through loss, jitter and kills."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import tyro
from rich.table import Table

from mulan.cli.progress import console
from mulan.fleet.soak import SoakConfig, soak
from mulan.fleet.soak_mission import SoakMissionConfig, simulate_soak_mission


@dataclass(frozen=True)
class Options:
    """A base station and robots as separate processes on a bad link, some of them killed; what was lost?"""

    out: Path
    """Folder to write; metrics.json lies in it."""
    bag: Path | None = None
    """Mission the robots replay; without it three simulated robots in a rendered room."""
    simulated: SoakMissionConfig = field(default_factory=SoakMissionConfig)
    """The mission, where no bag is given."""
    minutes: float = SoakConfig.minutes
    """How long."""
    recorded_share: float = SoakConfig.recorded_share
    """The bag is replayed in this share of it, slower or faster than recorded; a simulated one lasts as long.
    What was missed is sent in the rest."""
    loss: float = SoakConfig.loss
    """Messages lost, each way."""
    jitter_s: float = SoakConfig.jitter_s
    """Random delay, each way, up to this."""
    duplicate: float = SoakConfig.duplicate
    """Messages that come twice."""
    robot_away_s: float = SoakConfig.robot_away_s
    """The second robot is killed for this long, or a sixth of the test if that is shorter; 0 leaves it be."""
    base_kills: int = SoakConfig.base_kills
    """How often the base station is killed."""
    localize: bool = True
    """Localize from the received bag and from the undisturbed one, and compare."""
    instants: int = SoakConfig.instants
    """Localize also from what had come by so many instants, evenly spread."""
    seed: int = 0
    """Source of all randomness."""


def main(arguments: Sequence[str]) -> int:
    """Run the test and tell what was lost."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet soak")
    bag = options.bag
    if bag is None:
        bag = options.out / "undisturbed.mcap"
        if not bag.exists():
            console.print("Photographing the room")
            options.out.mkdir(parents=True, exist_ok=True)
            duration_s = 60 * options.minutes * options.recorded_share
            simulate_soak_mission(options.simulated, duration_s, options.seed, bag)
    chosen = {f.name: getattr(options, f.name) for f in fields(SoakConfig) if f.name != "bag"}
    metrics = soak(SoakConfig(bag=bag, **chosen), lambda text: console.print(f"[dim]{text}[/]"))
    table = Table(box=None, show_header=False, padding=(0, 2))
    for name, value in metrics["messages"].items():
        table.add_row(name.replace("_", " "), str(value))
    for who, count in metrics["restarts_survived"].items():
        table.add_row(f"restarts of {who}", str(count))
    for pair, value in metrics["coordination_bytes_per_mission_s_and_pair"].items():
        table.add_row(f"coordination {pair}", f"{value / 1e3:.2f} kB/s")
    for importance, lag in metrics["lag_s"].items():
        table.add_row(f"lag of {importance}", f"{lag['median']:.2f} s median, {lag['largest']:.0f} s at most")
    console.print(table)
    console.print(f"Metrics: [bold]{options.out / 'metrics.json'}[/]")
    return 0 if metrics["messages"]["lost"] == 0 else 1
