"""``mulan import``: recordings and models of other projects, brought in."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from mulan.cli.progress import console, progress_bar
from mulan.errors import InputError
from mulan.mission.bag_writer import write_mission
from mulan.mission.colmap.read_model import find_model
from mulan.mission.image_sets import TRANSFORMS
from mulan.mission.imports.bag_import import import_bag
from mulan.mission.imports.colmap_images import read_colmap_images
from mulan.mission.imports.foreign_bag import BAG_SUFFIXES, open_bag
from mulan.mission.imports.foreign_messages import BagImportConfig
from mulan.mission.imports.topic_list import suggested_topic_map
from mulan.mission.imports.topic_map import read_topic_map
from mulan.mission.imports.tum_images import InterpolationConfig, read_tum_images
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.placed_images import place_images
from mulan.mission.posed_images import PosedImageSet


@dataclass(frozen=True)
class Options:
    """Bring in a ROS bag as a mission, a COLMAP model or a TUM trajectory as posed images."""

    source: Annotated[Path, tyro.conf.Positional]
    """A .bag, .mcap or .db3 file or rosbag2 folder; a COLMAP folder; or a TUM trajectory."""
    out: Path | None = None
    """What to write: for a bag the mission, ending in .mcap; else a folder for transforms.json and images."""
    list_topics: Annotated[bool, tyro.conf.arg(name="list")] = False
    """Of a bag, print the topics and a topic map to edit, and write nothing."""
    topics: Path | None = None
    """Of a bag: the topic map (TOML); --list prints one to begin with."""
    images: Path | None = None
    """Of COLMAP or TUM: the photographs' folder."""
    calibration: Path | None = None
    """Of TUM: TOML with [camera] (width, height, fx, fy, cx, cy, distortion) and perhaps [camera_mount]."""
    times: Path | None = None
    """Of TUM: list of times and photographs, if it is not found beside them."""
    scale: float = 1.0
    """Of COLMAP: metres a COLMAP unit."""
    link: bool = False
    """Hard links to the photographs instead of copies, where the file system allows."""
    raw_images: BagImportConfig = field(default_factory=BagImportConfig)
    """Of a bag: how raw images are compressed."""
    poses: InterpolationConfig = field(default_factory=InterpolationConfig)
    """Of TUM: how near recorded poses must be."""


def _needed(value: Path | None, option: str, remedy: str) -> Path:
    if value is None:
        raise InputError(option, "value", "is missing", remedy)
    return value


def print_topics(source: Path) -> None:
    """What a bag holds, and a topic map for it on standard output."""
    with open_bag(source) as bag:
        lines = [f"# {topic.count:8d}  {topic.name}  ({topic.msgtype})" for topic in bag.topics]
        print("\n".join([f"# {source.name} holds", *lines, "", suggested_topic_map(bag.topics)]))


def import_mission(options: Options) -> Path:
    """A bag as a mission; its path."""
    out = _needed(options.out, "--out", "name the mission to write, such as mission.mcap")
    if options.topics is None:
        raise InputError(
            "--topics",
            "value",
            "is missing, so nothing says which topic is what",
            f"write one: mulan import {options.source} --list > topics.toml",
        )
    if out.suffix != ".mcap":
        raise InputError(out, "file name", "does not end in .mcap", "choose a name such as mission.mcap")
    if out.resolve() == options.source.resolve():
        raise InputError(out, "--out", "is the bag to read", "choose another name")
    topics = read_topic_map(options.topics)
    with progress_bar("Reading") as progress:
        imported = import_bag(options.source, topics, options.raw_images, progress)
    for remark in imported.remarks:
        console.print(f"[yellow bold]note[/] {remark}")
    write_mission(imported.mission, out)
    for robot in imported.mission.robots:
        packets = sum(len(track.time_s) for track in robot.csi.values())
        ranges = sum(len(track.time_s) for track in robot.ranges.values())
        console.print(
            f"{robot.name}: {len(robot.photos)} photographs, {len(robot.odometry.time_s)} odometry poses,"
            f" {packets} radio packets, {ranges} ranges"
        )
    return out


def import_images(options: Options) -> PosedImageSet:
    """A COLMAP model or a trajectory as posed images."""
    if options.source.is_dir():
        return read_colmap_images(options.source, options.images, options.scale)
    folder = _needed(options.images, "--images", "name the folder of photographs taken along the trajectory")
    calibration = _needed(options.calibration, "--calibration", "name a TOML file with a [camera] table")
    return read_tum_images(options.source, folder, calibration, options.times, options.poses)


def main(arguments: Sequence[str]) -> int:
    """Import one source."""
    options = tyro.cli(Options, args=arguments, prog="mulan import")
    source = options.source
    if not source.exists():
        raise InputError(source, "source", "does not exist", "check the path")
    is_bag = source.suffix in BAG_SUFFIXES or (source / "metadata.yaml").is_file()
    if options.list_topics and not is_bag:
        raise InputError(source, "--list", "is for bags", "leave it out")
    if options.list_topics:
        print_topics(source)
    elif is_bag:
        mission = import_mission(options)
        console.print(f"Mission: [bold]{mission}[/]")
        console.print(f"Next: [cyan]mulan run {mission} --out runs/{mission.stem}[/]")
    elif source.is_dir() and find_model(source) is None:
        raise InputError(
            source,
            "folder",
            "is neither a rosbag2 folder (metadata.yaml) nor a COLMAP model (cameras.bin or .txt)",
            "name a bag, a COLMAP project or a TUM trajectory",
        )
    else:
        out = _needed(options.out, "--out", "name a folder for transforms.json and the photographs")
        images = import_images(options)
        placed = place_images(images, out / "images", options.link)
        write_transforms(placed, out / TRANSFORMS)
        console.print(f"Posed images: [bold]{out / TRANSFORMS}[/] ({len(placed.train)})")
        console.print(f"Next: [cyan]mulan train runs/{out.name} --data {out}[/]")
    return 0
