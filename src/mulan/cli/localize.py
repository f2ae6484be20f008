"""``mulan localize``: a bag's odometry and radio into poses with covariance."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from mulan.cli.calibration_option import calibrated
from mulan.cli.link_faults import print_faults
from mulan.cli.progress import console, progress_bar
from mulan.localization.accuracy import RobotAccuracy, accuracy, world_from_truth
from mulan.localization.localize import LocalizationConfig, localize
from mulan.localization.posed_images import localized_images
from mulan.localization.run_files import write_localization
from mulan.localization.types import Localization
from mulan.mission.bag_reader import read_mission
from mulan.mission.extract import extract_photos
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.photograph_information import read_photograph_information
from mulan.mission.run_folder import RunFolder
from mulan.wireless.bearing import BearingConfig


@dataclass(frozen=True)
class Options:
    """Turn a bag's odometry and radio into every robot's poses in one frame, with covariance."""

    bag: Annotated[Path, tyro.conf.Positional]
    """Mission bag (.mcap file or rosbag2 folder)."""
    out: Path
    """Run folder to write."""
    hold_out_every: int = 8
    """Every n-th photograph becomes a test view where the bag names none; 0 holds out none."""
    graph: LocalizationConfig = field(default_factory=LocalizationConfig)
    """Factor graph."""
    bearings: BearingConfig = field(default_factory=BearingConfig)
    """Radio bearings."""
    calibration: Path | None = None
    """Calibration of the bearings made by 'mulan calibrate'."""
    photographs: Path | None = None
    """photographs.safetensors of a run whose poses were refined: they join odometry and radio as a factor."""


def print_accuracy(figures: dict[str, RobotAccuracy]) -> None:
    """A table of pose errors against the ground truth."""
    table = Table(box=None, header_style="dim", padding=(0, 2))
    for heading in ("robot", "position RMS", "yaw RMS", "NEES/dof"):
        table.add_column(heading, justify="left" if heading == "robot" else "right")
    for robot, figure in figures.items():
        table.add_row(
            robot,
            f"{figure.position_rms_m * 100:.1f} cm",
            f"{figure.yaw_rms_deg:.2f}°",
            f"{figure.nees_per_dof:.2f}",
        )
    console.print(table)


def print_verdict(localization: Localization) -> None:
    """Robots that lie and robots that cannot be placed, each in a sentence."""
    for suspect in localization.suspects:
        others = f" (or {', '.join(suspect.alternatives)})" if suspect.alternatives else ""
        console.print(f"[yellow]Not believed:[/] {suspect.robot}{others}: {suspect.sentence()}")
    for robot in localization.undetermined:
        console.print(f"[yellow]Not placed yet:[/] {robot.sentence()}")


def localize_bag(bag: Path, run: RunFolder, options: Options) -> None:
    """Read the bag, localize, write poses, covariances and the posed image set into the run.

    Raises:
        InputError: No robot beside the anchor can be placed; nothing is written then.
    """
    mission = read_mission(bag)
    bearings = calibrated(options.bearings, options.calibration)
    photographs = read_photograph_information(options.photographs) if options.photographs else None
    run.check_writable()
    with progress_bar("Localizing") as progress:
        localization = localize(mission, options.graph, bearings, progress, photographs)
    localization.require_any_placed()
    write_localization(localization, mission, run)
    files = extract_photos(mission, run)
    images = localized_images(mission, localization, files, world_from_truth(mission), options.hold_out_every)
    write_transforms(images, run.transforms)
    outliers = int((localization.bearing_inlier < 0.5).sum())
    console.print(
        f"{len(localization.trajectories)} robots in {localization.anchor}'s start frame from "
        f"{len(localization.bearings)} bearings ({outliers} set aside) and {len(localization.ranges)} ranges"
    )
    print_verdict(localization)
    print_faults(localization.bearings)
    if figures := accuracy(localization, mission):
        print_accuracy(figures)


def main(arguments: Sequence[str]) -> int:
    """Localize one bag."""
    options = tyro.cli(Options, args=arguments, prog="mulan localize")
    run = RunFolder(options.out)
    localize_bag(options.bag, run, options)
    run.record_config("localize", asdict(options))
    console.print(
        f"Poses: [bold]{run.poses}[/], picture: [bold]{run.localization.with_suffix('.png')}[/], "
        f"posed images: [bold]{run.transforms}[/]"
    )
    console.print(f"Next: [cyan]mulan train {options.out}[/]")
    return 0
