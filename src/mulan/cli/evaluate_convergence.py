"""``mulan evaluate convergence``: how far off a robot may be, and whether failures are told."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table
from tyro.conf import EnumChoicesFromValues

from mulan.cli.evaluate_engine import recordings
from mulan.cli.evaluate_table1 import QUICK_S, QUICK_SIZE
from mulan.cli.progress import console, progress_stages
from mulan.errors import InputError
from mulan.evaluation.convergence.protocol import ERRORS, PICTURE, ConvergenceConfig, convergence
from mulan.evaluation.table1.team import Split
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import RunFolder
from mulan.radiance.backend import Device
from mulan.reconstruction.train_config import TrainConfig


@dataclass(frozen=True)
class Options:
    """One error of a whole robot, from small to hopeless: do its poses come right, and does the run know?"""

    out: Path
    """Folder to write: metrics.json, convergence.png, a folder a seed."""
    data: Path = field(default_factory=lambda: recordings() / "nerf_synthetic_lego")
    """Posed image set: a folder or transforms.json (Blender, nerfstudio, instant-ngp)."""
    hold_out_every: int = 8
    """Every n-th image becomes a test view where the set names none."""
    seeds: int = 3
    """Repetitions."""
    errors: str = ",".join(f"{metres:g}:{degrees:g}" for metres, degrees in ERRORS)
    """Displacements in metres and turns in degrees, as metres:degrees, separated by commas."""
    split: EnumChoicesFromValues[Split] = Split.AZIMUTH
    """Who takes which photograph."""
    quick: bool = False
    """100 pixels and 20 s a training unless given."""
    image_size: int | None = None
    """Longest image side in pixels; 200 if not given."""
    time_budget: Annotated[float | None, tyro.conf.arg(aliases=["--time-budget-s"])] = None
    """Seconds of each training; 180 if not given."""
    steps: int | None = None
    """Optimiser steps of each training instead of seconds."""


def errors_of(text: str) -> tuple[tuple[float, float], ...]:
    """Errors by their text.

    Raises:
        InputError: It is no list of pairs of positive numbers.
    """
    try:
        pairs = [tuple(float(number) for number in word.split(":")) for word in text.split(",")]
        if all(len(pair) == 2 and min(pair) > 0 for pair in pairs):
            return tuple((pair[0], pair[1]) for pair in pairs)
    except ValueError:
        pass
    raise InputError("--errors", "value", f"'{text}' names no errors", "write them like 0.4:7,1.2:21")


def print_convergence(metrics: dict[str, Any]) -> None:
    """A line an error."""
    table = Table(box=None, header_style="dim", padding=(0, 1))
    for heading in ("error", "true", "uncorrected", "refined", "of A−B", "median", "converged", "told"):
        table.add_column(heading, justify="right", no_wrap=True)
    for error in metrics["errors"]:
        told = "–" if error["told"] is None else f"{100 * error['told']:.0f} %"
        table.add_row(
            f"{error['displacement_m']:g} m, {error['turn_deg']:g}°",
            *(f"{error['psnr_db'][name]:.2f}" for name in ("A", "B", "ours")),
            f"{100 * error['gap_recovered']:.0f} %",
            f"{100 * error['camera_median_m']:.1f} cm",
            f"{100 * error['converged']:.0f} %",
            told,
        )
    console.print(table)
    console.print("[dim]PSNR of held-out views in dB; told: of the attempts that did not converge[/]")


def main(arguments: Sequence[str]) -> int:
    """Learn, score, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate convergence")
    run, errors = RunFolder(options.out), errors_of(options.errors)
    size, budget_s = (QUICK_SIZE, QUICK_S) if options.quick else (200, 180.0)
    training = TrainConfig(
        image_size=options.image_size or size,
        time_budget_s=options.time_budget or budget_s,
        steps=options.steps,
        device=Device.CPU,
    )
    config = ConvergenceConfig(options.seeds, errors, options.split, training)
    images = read_posed_images(options.data, options.hold_out_every)
    with progress_stages() as stage:
        metrics = convergence(images, config, run, stage, console.print)
    run.record_config("evaluate convergence", asdict(options))
    print_convergence(metrics)
    console.print(f"Metrics: [bold]{run.metrics}[/], picture: [bold]{run.root / PICTURE}[/]")
    return 0
