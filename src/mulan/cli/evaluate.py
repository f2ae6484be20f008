"""``mulan evaluate``: the experiments behind the published numbers."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import tyro
from rich.table import Table

from mulan.cli import (
    evaluate_aoa,
    evaluate_aoa_metric,
    evaluate_aoa_simulation,
    evaluate_convergence,
    evaluate_engine,
    evaluate_localization,
    evaluate_table1,
    evaluate_table2,
    evaluate_table3,
    evaluate_uwb,
    evaluate_view_selection,
)
from mulan.cli.progress import console, progress_stages
from mulan.cli.simulate import describe
from mulan.errors import InputError
from mulan.evaluation.setups import compare_setups
from mulan.localization.localize import LocalizationConfig
from mulan.mission.bag_reader import read_mission
from mulan.mission.bag_writer import write_mission
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.train_config import TrainConfig
from mulan.report.page import write_report
from mulan.simulation.from_images import ImageMissionConfig, simulate_from_images
from mulan.simulation.recording import SensorConfig
from mulan.simulation.timeline import TourConfig
from mulan.wireless.bearing import BearingConfig

EXPERIMENTS = {
    "aoa": "Angle of arrival on recorded links with known geometry, beside the authors' results.",
    "aoa-metric": "The paper's two figures of its AoA metric, beside our sigma on the same trials.",
    "aoa-simulation": "Bearings from simulated links, against theory and the paper's metric.",
    "convergence": "Growing errors of a whole robot: whether its poses come right and failures are told.",
    "engine": "Quality against training time, throughput and memory, beside torch and the peers.",
    "localization": "Poses and covariances against the Cramér–Rao bound, real recordings, online.",
    "table1": "The paper's first table: two robots, noisy poses, its setups beside ours.",
    "table2": "The paper's second table: motion capture, drifting odometry, weights, ours, COLMAP.",
    "table3": "The paper's active views: two robots in a room choose moves, every rule from one start.",
    "two-robot": "True poses, wireless poses, wireless poses with weights, on one mission.",
    "uwb": "Likelihood and coverage of calibrated UWB ranges on held-out recordings.",
    "view-selection": "Rules for choosing views on a set of photographs, from the same first views.",
}

_OF_THEIR_OWN = {
    "aoa": evaluate_aoa.main,
    "aoa-metric": evaluate_aoa_metric.main,
    "aoa-simulation": evaluate_aoa_simulation.main,
    "convergence": evaluate_convergence.main,
    "engine": evaluate_engine.main,
    "localization": evaluate_localization.main,
    "table1": evaluate_table1.main,
    "table2": evaluate_table2.main,
    "table3": evaluate_table3.main,
    "uwb": evaluate_uwb.main,
    "view-selection": evaluate_view_selection.main,
}

_TITLES = {
    "oracle": "A  true poses",
    "wireless": "B  wireless poses",
    "uncertainty": "C  wireless poses, weighted",
}


@dataclass(frozen=True)
class TwoRobotOptions:
    """Setups A, B, C of the paper on a posed image set shared by simulated robots with drift and radio."""

    data: Path
    """Posed image set: a folder or transforms.json (Blender, nerfstudio, instant-ngp)."""
    out: Path
    """Run folder to write; metrics.json lies in it."""
    image_size: int = 100
    """Longest image side in pixels."""
    time_budget: float = 120.0
    """Seconds of training for each setup."""
    seed: int = 0
    """Source of all randomness."""
    robots: int = 2
    """Number of robots."""
    split: Literal["azimuth", "random", "alternate"] = "azimuth"
    """Who takes which photograph."""
    hold_out_every: int = 8
    """Every n-th image becomes a test view where the set names none."""
    metres_per_unit: float = 1.0
    """Size of one unit of the set's poses."""
    tour: TourConfig = field(default_factory=TourConfig)
    """Pace of the robots."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """Noise of odometry, WiFi and UWB."""


def print_setups(metrics: dict[str, Any]) -> None:
    """The comparison as a short table."""
    table = Table(box=None, header_style="dim", padding=(0, 2))
    for heading in ("setup", "PSNR", "SSIM", "camera RMS", "training"):
        table.add_column(heading, justify="left" if heading == "setup" else "right")
    for name, setup in metrics["setups"].items():
        table.add_row(
            _TITLES.get(name, name),
            f"{setup['psnr_db']:.2f} dB",
            f"{setup['ssim']:.3f}",
            f"{setup['camera_rms_m'] * 100:.1f} cm",
            f"{setup['train_seconds']:.0f} s",
        )
    console.print(table)


def two_robot(options: TwoRobotOptions) -> dict[str, Any]:
    """Simulate the mission, write it as a bag, read it back, compare the setups, write the report."""
    run = RunFolder(options.out)
    images = read_posed_images(options.data, options.hold_out_every)
    if not images.test:
        raise InputError(options.data, "test images", "there are none to score", "give --hold-out-every 8")
    mission = simulate_from_images(
        images,
        ImageMissionConfig(
            robots=options.robots,
            split=options.split,
            metres_per_unit=options.metres_per_unit,
            seed=options.seed,
            tour=options.tour,
            sensors=options.sensors,
        ),
    )
    bag = run.root / "mission.mcap"
    write_mission(mission, bag)
    mission = read_mission(bag)
    console.print(describe(mission))
    config = TrainConfig(image_size=options.image_size, time_budget_s=options.time_budget, seed=options.seed)
    with progress_stages() as stage:
        metrics = compare_setups(mission, run, config, LocalizationConfig(), BearingConfig(), stage)
    print_setups(metrics)
    return metrics


def main(arguments: Sequence[str]) -> int:
    """Run one experiment."""
    if not arguments or arguments[0] in ("-h", "--help"):
        table = Table(box=None, show_header=False, padding=(0, 2))
        for name, purpose in EXPERIMENTS.items():
            table.add_row(f"[cyan]mulan evaluate {name}[/]", purpose)
        console.print(table)
        return 0
    name, *rest = arguments
    if name not in EXPERIMENTS:
        raise InputError(
            "mulan evaluate", f"experiment '{name}'", "is unknown", f"choose from {', '.join(EXPERIMENTS)}"
        )
    if name in _OF_THEIR_OWN:
        return _OF_THEIR_OWN[name](rest)
    options = tyro.cli(TwoRobotOptions, args=rest, prog="mulan evaluate two-robot")
    two_robot(options)
    run = RunFolder(options.out)
    run.record_config("evaluate two-robot", asdict(options))
    page = write_report(run)
    console.print(f"Metrics: [bold]{run.metrics}[/], report: [bold]{page.resolve()}[/]")
    return 0
