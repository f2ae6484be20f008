"""``mulan evaluate table3``: active views in a closed loop, every rule from the same start."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import tyro

from mulan.cli.paired_gains import paired_gains_table
from mulan.cli.progress import console, progress_stages
from mulan.evaluation.table3.policies import TITLES
from mulan.mission.run_folder import RunFolder


@dataclass(frozen=True)
class Options:
    """Two robots with wireless poses in the furnished room choose one of eight moves, four times.

    After each observation the field is learnt from scratch and judged on test views.
    """

    out: Path
    """Folder to write: metrics.json, table3.png, a folder a seed."""
    seeds: int = 10
    """Repetitions; each draws its own start, photographs' noise, radio and fields."""
    first_seed: int = 1
    """Seed of the first repetition; options are tried out on 1000 and above."""
    policies: str = ""
    """Policies to compare, separated by commas; the five published if empty. Those finished earlier with the
    same options are shown too."""
    steps: int = 600
    """Optimiser steps of each field that is judged."""


def print_table(metrics: dict[str, Any]) -> None:
    """PSNR at every observation, and the paired gains over the two references."""
    console.print(paired_gains_table(metrics["policies"], TITLES, "observations"))
    console.print("[dim]mean PSNR of the test views in dB by observation; paired gains with 95 % interval[/]")


def main(arguments: Sequence[str]) -> int:
    """Explore, learn, judge, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate table3")
    # Mitsuba takes a second to load, which --help need not wait for
    from mulan.evaluation.table3.protocol import PICTURE, Table3Config, table3
    from mulan.evaluation.table3.trial import TrialConfig

    policies = tuple(word.strip() for word in options.policies.split(",") if word.strip())
    config = Table3Config(options.seeds, options.first_seed, policies, TrialConfig(steps=options.steps))
    run = RunFolder(options.out)
    with progress_stages() as stage:
        metrics = table3(config, run, stage, console.print)
    run.record_config("evaluate table3", asdict(options))
    print_table(metrics)
    console.print(f"Metrics: [bold]{run.metrics}[/], picture: [bold]{run.root / PICTURE}[/]")
    return 0
