"""``mulan evaluate aoa-simulation``: the bearing estimator against theory."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from mulan.cli.progress import console, progress_stages
from mulan.evaluation.aoa_simulation.experiments import AoaSimulationConfig
from mulan.evaluation.aoa_simulation.protocol import METRICS, PICTURE, evaluate_aoa_simulation


@dataclass(frozen=True)
class Options:
    """Errors against the bound, sigma against errors, echoes against the paper's metric, near field."""

    out: Path
    """Folder to write; metrics.json and aoa-simulation.png lie in it."""
    quick: bool = False
    """Few links: shows that the command works, measures nothing."""
    simulation: Annotated[AoaSimulationConfig, tyro.conf.arg(name="")] = field(
        default_factory=AoaSimulationConfig
    )
    """Size of the simulation."""


def main(arguments: Sequence[str]) -> int:
    """Simulate, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate aoa-simulation")
    config = options.simulation
    if options.quick:
        config = replace(
            config,
            noise_rad=(0.1, 1.0),
            trials=4,
            packets=100,
            multipath_trials=10,
            resolved_trials=1,
            near_field_trials=1,
        )
    with progress_stages() as stage:
        metrics = evaluate_aoa_simulation(config, options.out, stage("simulating links"))
    for name, met in metrics["goals"].items():
        console.print(f"{'[green]met   [/]' if met else '[red]missed[/]'} {name.replace('_', ' ')}")
    console.print(f"Metrics: [bold]{options.out / METRICS}[/], picture: [bold]{options.out / PICTURE}[/]")
    return 0
