"""``mulan run``: localize, train, plan and report on one bag."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mulan.cli import localize as localize_command
from mulan.cli import train as train_command
from mulan.cli.plan import plan
from mulan.cli.progress import console
from mulan.localization.localize import LocalizationConfig
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.run_folder import RunFolder
from mulan.planning.plan import PlanConfig
from mulan.reconstruction.train_config import TrainConfig
from mulan.report.page import write_report
from mulan.wireless.bearing import BearingConfig


@dataclass(frozen=True)
class Options:
    """The whole loop on one bag: localize, train, plan, report."""

    bag: Annotated[Path, tyro.conf.Positional]
    """Mission bag (.mcap file or rosbag2 folder)."""
    out: Path
    """Run folder to write."""
    weighting: Literal["none", "paper", "uncertainty"] = "uncertainty"
    """Trust in each pixel: equal, the paper's formula as printed, or what its pose covariance deserves."""
    hold_out_every: int = 8
    """Every n-th photograph becomes a test view where the bag names none; 0 holds out none."""
    plan_columns: int = 32
    """Rays across a candidate view's image when planning."""
    graph: LocalizationConfig = field(default_factory=LocalizationConfig)
    """Factor graph."""
    bearings: BearingConfig = field(default_factory=BearingConfig)
    """Radio bearings."""
    calibration: Path | None = None
    """Calibration of the bearings made by 'mulan calibrate'."""
    train: tyro.conf.AvoidSubcommands[TrainConfig] = field(default_factory=TrainConfig)
    """Training."""


def run_bag(options: Options) -> Path:
    """All stages in turn; returns the report page."""
    run = RunFolder(options.out)
    localize_command.localize_bag(
        options.bag,
        run,
        localize_command.Options(
            options.bag,
            options.out,
            options.hold_out_every,
            options.graph,
            options.bearings,
            options.calibration,
        ),
    )
    run.record_config("run", asdict(options))
    images = read_transforms(run.transforms)
    train_command.train_run(run, images, train_command.weighting_named(options.weighting), options.train)
    plan(run, PlanConfig(columns=options.plan_columns))
    return write_report(run)


def main(arguments: Sequence[str]) -> int:
    """Run the loop."""
    options = tyro.cli(Options, args=arguments, prog="mulan run")
    page = run_bag(options)
    console.print(f"Report: [bold]{page.resolve()}[/]")
    console.print(f"Next: [cyan]mulan render {options.out}[/]")
    return 0
