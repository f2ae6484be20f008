"""``mulan evaluate table1``: the paper's first table, its setups beside ours."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.table import Table
from tyro.conf import EnumChoicesFromValues

from mulan.cli.evaluate_engine import recordings
from mulan.cli.progress import ReportProgress, console, progress_stages
from mulan.errors import InputError
from mulan.evaluation.table1.loop import LoopSource
from mulan.evaluation.table1.pose_noise import RadioNoiseConfig, RigidNoiseConfig
from mulan.evaluation.table1.protocol import BARS, TITLES, VIEWS, Table1Config, table1
from mulan.evaluation.table1.real_radio import RealRadioSource
from mulan.evaluation.table1.recorded_bearings import recorded_bearings
from mulan.evaluation.table1.sources import Noise, PaperSource, TeamSource
from mulan.evaluation.table1.team import Split
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import RunFolder
from mulan.radiance.backend import Device
from mulan.reconstruction.train_config import TrainConfig
from mulan.simulation.recording import SensorConfig
from mulan.simulation.timeline import TourConfig

QUICK_SIZE, QUICK_S = 100, 20.0
WORKERS = 2


@dataclass(frozen=True)
class Options:
    """Two robots, noisy poses: true poses, wireless poses, weights, one robot alone, poses refined."""

    out: Path
    """Folder to write: metrics.json, psnr.png, views.png, a folder a seed and setup."""
    data: Path = field(default_factory=lambda: recordings() / "nerf_synthetic_lego")
    """Posed image set: a folder or transforms.json (Blender, nerfstudio, instant-ngp)."""
    hold_out_every: int = 8
    """Every n-th image becomes a test view where the set names none."""
    protocol: Literal["paper", "loop", "real-radio"] = "paper"
    """Where poses come from: a noisy range and bearing an image, as in the paper; simulated odometry, CSI and
    UWB through localization; or a range and the bearing of a recorded link an image."""
    seeds: int = 5
    """Repetitions; each draws its own noise, split and field."""
    first_seed: int = 0
    """Seed of the first repetition; the others' files in the same folder are kept."""
    split: EnumChoicesFromValues[Split] = Split.AZIMUTH
    """Who takes which photograph: half of the directions each, half by lot, or 15 each."""
    noise: EnumChoicesFromValues[Noise] = Noise.EQUAL
    """With --protocol paper, what is wrong with the second robot's poses: each image's own range and bearing,
    equally good; bearings of 1° to 15°; one error of the whole robot; nothing."""
    only: str = ""
    """Setups to learn, separated by commas; those finished earlier with the same options are shown too."""
    quick: bool = False
    """100 pixels and 20 s a setup unless given: a look, no measurement."""
    image_size: int | None = None
    """Longest image side in pixels; 200 if not given."""
    time_budget: Annotated[float | None, tyro.conf.arg(aliases=["--time-budget-s"])] = None
    """Seconds of training for each setup; 180 if not given."""
    steps: int | None = None
    """Optimiser steps of each setup instead of seconds; makes the result repeatable bit for bit."""
    links: Path = field(default_factory=lambda: recordings() / "wsr_aoa")
    """With --protocol real-radio: folder of recorded links in the WSR layout."""
    metres_per_unit: float = 1.0
    """With --protocol loop: size of one unit of the set's poses."""
    tour: TourConfig = field(default_factory=TourConfig)
    """With --protocol loop: pace of the robots."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """With --protocol loop: noise of odometry, WiFi and UWB."""
    radio: RadioNoiseConfig = field(default_factory=RadioNoiseConfig)
    """How good range and bearing are."""
    rigid: RigidNoiseConfig = field(default_factory=RigidNoiseConfig)
    """How large the error of the whole robot is, with --noise rigid."""
    lpips_weights: Path | None = None
    """torchvision's file of AlexNet's weights for LPIPS; looked for in torch's cache if not given."""
    device: EnumChoicesFromValues[Device] = Device.CPU
    """Where to learn and render."""


def source(options: Options, stage: Callable[[str], ReportProgress]) -> TeamSource:
    """Where photographs and poses come from.

    Raises:
        InputError: The images or links cannot be read, or an option belongs to another protocol.
    """
    images = read_posed_images(options.data, options.hold_out_every)
    if options.protocol != "paper" and options.noise is not Noise.EQUAL:
        raise InputError(
            "--noise", options.noise.value, f"means nothing to --protocol {options.protocol}", "leave it out"
        )
    match options.protocol:
        case "paper":
            return PaperSource(images, options.split, options.noise, options.radio, options.rigid)
        case "real-radio":
            kept = options.out / "bearings.json"
            links = recorded_bearings(options.links, kept, WORKERS, stage("Bearings of recorded links"))
            return RealRadioSource(images, links, options.split, options.radio)
        case "loop":
            return LoopSource(images, options.split, options.metres_per_unit, options.tour, options.sensors)


def table_config(options: Options) -> Table1Config:
    """What the options ask for."""
    size, budget_s = (QUICK_SIZE, QUICK_S) if options.quick else (200, 180.0)
    training = TrainConfig(
        image_size=options.image_size or size,
        time_budget_s=options.time_budget or budget_s,
        steps=options.steps,
        device=options.device,
    )
    only = tuple(word.strip() for word in options.only.split(",") if word.strip())
    return Table1Config(options.seeds, options.first_seed, only, training, options.lpips_weights)


def print_table(metrics: dict[str, Any]) -> None:
    """The comparison as a short table."""
    table = Table(box=None, header_style="dim", padding=(0, 1))
    table.add_column("setup", no_wrap=True)
    for heading in ("PSNR", "aligned", "RMS", "median", "of A−B", "of A−alone", "time"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name, setup in metrics["setups"].items():
        psnr = setup["psnr_db"]
        table.add_row(
            TITLES[name],
            f"{psnr['mean']:.2f}" + ("" if psnr["std"] is None else f" ± {psnr['std']:.2f}"),
            _cell(setup["aligned_psnr_db"], ".2f"),
            _cell(setup["camera_rms_m"], ".1f", 100),
            _cell(setup["camera_median_m"], ".1f", 100),
            _cell(metrics["gap_recovered"].get(name), ".0f", 100, " %"),
            _cell(metrics["gap_recovered_vs_alone"].get(name), ".0f", 100, " %"),
            _cell(setup["train_seconds"], ".0f", 1, " s"),
        )
    console.print(table)
    console.print("[dim]PSNR of held-out views in dB; RMS, median: camera errors in cm[/]")


def _cell(value: float | None, form: str, scale: float = 1.0, unit: str = "") -> str:
    return "–" if value is None else format(scale * value, form) + unit


def main(arguments: Sequence[str]) -> int:
    """Learn, score, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate table1")
    run = RunFolder(options.out)
    with progress_stages() as stage:
        metrics = table1(source(options, stage), table_config(options), run, stage, console.print)
    run.record_config("evaluate table1", asdict(options))
    print_table(metrics)
    for figure, reason in metrics["unavailable"].items():
        console.print(f"[dim]{figure}: not available, {reason}[/]")
    console.print(f"Metrics: [bold]{run.metrics}[/]")
    console.print(f"Pictures: [bold]{run.root / BARS}[/], [bold]{run.root / VIEWS}[/]")
    return 0
