"""``mulan evaluate table2``: the paper's hardware experiment, in simulation or past anyone's photographs."""

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
from mulan.evaluation.table1.team import Split
from mulan.evaluation.table2.colmap import ColmapConfig
from mulan.evaluation.table2.hardware import Drift, HardwareSource
from mulan.evaluation.table2.protocol import BARS, VIEWS, Table2Config, table2
from mulan.evaluation.table2.setups import TITLES
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import RunFolder
from mulan.radiance.backend import Device
from mulan.reconstruction.train_config import TrainConfig
from mulan.simulation.recording import SensorConfig
from mulan.simulation.timeline import TourConfig


@dataclass(frozen=True)
class Options:
    """Two robots by motion capture, by drifting odometry and radio, with weights, refined, and by COLMAP."""

    out: Path
    """Folder to write: metrics.json, psnr.png, views.png, a folder a seed and setup."""
    data: Path = field(default_factory=lambda: recordings() / "nerf_synthetic_lego")
    """Posed image set: a folder or transforms.json (Blender, nerfstudio, instant-ngp)."""
    hold_out_every: int = 8
    """Every n-th image becomes a test view where the set names none."""
    seeds: int = 5
    """Repetitions; each draws its own noise and field."""
    drift: EnumChoicesFromValues[Drift] = Drift.BOTH
    """Whose odometry drifts in C, D, ours and E: both robots', so that none is exact, or the second one's."""
    split: EnumChoicesFromValues[Split] = Split.AZIMUTH
    """Who takes which photograph: half of the directions each, half by lot, or 15 each."""
    only: str = ""
    """Setups to learn, separated by commas: A, B, C, D, ours, E, E_poses."""
    quick: bool = False
    """100 pixels and 20 s a setup unless given: a look, no measurement."""
    image_size: int | None = None
    """Longest image side in pixels; 200 if not given. COLMAP has the photographs as they are."""
    time_budget: Annotated[float | None, tyro.conf.arg(aliases=["--time-budget-s"])] = None
    """Seconds of training for each setup; 180 if not given."""
    steps: int | None = None
    """Optimiser steps of each setup instead of seconds; makes the result repeatable bit for bit."""
    metres_per_unit: float = 1.0
    """Size of one unit of the set's poses."""
    tour: TourConfig = field(default_factory=TourConfig)
    """Pace of the robots."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """Noise of odometry, WiFi and UWB."""
    colmap: ColmapConfig = field(default_factory=ColmapConfig)
    """How COLMAP is run."""
    lpips_weights: Path | None = None
    """torchvision's file of AlexNet's weights for LPIPS; looked for in torch's cache if not given."""


def print_table2(metrics: dict[str, Any]) -> None:
    """The comparison as a short table, what became of COLMAP, and which of the paper's inequalities hold."""
    table = Table(box=None, header_style="dim", padding=(0, 1))
    table.add_column("setup", no_wrap=True)
    for heading in ("PSNR", "aligned", "RMS", "median", "of A−C", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, setup in metrics["setups"].items():
        psnr, share = setup["psnr_db"], metrics["gap_recovered"].get(name)
        table.add_row(
            TITLES[name],
            f"{psnr['mean']:.2f}" + ("" if psnr["std"] is None else f" ± {psnr['std']:.2f}"),
            f"{setup['aligned_psnr_db']:.2f}",
            f"{100 * setup['camera_rms_m']:.1f}",
            f"{100 * setup['camera_median_m']:.1f}",
            "–" if share is None else f"{100 * share:.0f} %",
            f"{setup['train_seconds']:.0f} s",
        )
    console.print(table)
    console.print("[dim]PSNR of held-out views in dB; RMS, median: camera errors in cm[/]")
    for seed, found in metrics["colmap"].items():
        said = found["why_not"] or f"placed {found['placed']} of {found['of']} photographs"
        console.print(f"COLMAP, seed {seed}: {said}, {found['seconds']:.0f} s")
    for name, reasons in metrics["failed"].items():
        for seed, reason in reasons.items():
            console.print(f"{TITLES[name]}, seed {seed}: failed, {reason}")
    for pair, holds in metrics["order"].items():
        console.print(f"{pair}: {'holds' if holds else 'does not hold'}")


def main(arguments: Sequence[str]) -> int:
    """Learn, score, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate table2")
    run = RunFolder(options.out)
    size, budget_s = (QUICK_SIZE, QUICK_S) if options.quick else (200, 180.0)
    training = TrainConfig(
        image_size=options.image_size or size,
        time_budget_s=options.time_budget or budget_s,
        steps=options.steps,
        device=Device.CPU,
    )
    only = tuple(word.strip() for word in options.only.split(",") if word.strip())
    config = Table2Config(options.seeds, options.drift, only, training, options.colmap, options.lpips_weights)
    images = read_posed_images(options.data, options.hold_out_every)
    source = HardwareSource(images, options.split, options.metres_per_unit, options.tour, options.sensors)
    with progress_stages() as stage:
        metrics = table2(source, config, run, stage, console.print)
    run.record_config("evaluate table2", asdict(options))
    print_table2(metrics)
    for figure, reason in metrics["unavailable"].items():
        console.print(f"[dim]{figure}: not available, {reason}[/]")
    console.print(f"Metrics: [bold]{run.metrics}[/]")
    console.print(f"Pictures: [bold]{run.root / BARS}[/], [bold]{run.root / VIEWS}[/]")
    return 0
