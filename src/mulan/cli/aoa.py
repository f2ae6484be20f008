"""``mulan aoa FILE``: the angle-of-arrival profile of any recording."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.markup import escape
from rich.table import Table

from mulan.cli.calibration_option import calibrated
from mulan.cli.link_faults import print_faults
from mulan.cli.progress import console, progress_bar
from mulan.errors import InputError
from mulan.evaluation.aoa.truth import true_azimuth
from mulan.geometry import se3
from mulan.mission.bag_reader import read_mission
from mulan.mission.types import Mission
from mulan.wireless.antenna_faults import antenna_faults
from mulan.wireless.azimuth_density import azimuth_mixture, wrapped
from mulan.wireless.bearing import BearingConfig, KeepProfile, estimate_bearings
from mulan.wireless.directions import azimuth_elevation
from mulan.wireless.link_bearing import DisplacementSource, link_bearing
from mulan.wireless.profile_picture import DrawnBearing, draw_profiles
from mulan.wireless.recordings.card_robots import card_robots
from mulan.wireless.recordings.further_chips import CsiFileOptions, read_csi_file
from mulan.wireless.recordings.wsr import WsrRun, read_wsr_run
from mulan.wireless.recordings.wsr_raw import read_wsr_raw
from mulan.wireless.types import Bearing

_BAG_SUFFIXES = (".mcap", ".db3", ".bag")


@dataclass(frozen=True)
class Options:
    """Draw the profile of a recording, with the directions found and what is claimed about them."""

    file: Annotated[Path, tyro.conf.Positional]
    """A decoded run (.npz), a run folder with .dat files, a mission bag (.mcap, rosbag2 folder), or a card's
    file of any supported chip, which needs --reply and --path."""
    out: Path = Path("aoa.png")
    """Picture to write."""
    link: str = ""
    """Only this static robot of a run; of a bag, OBSERVER:PEER. All links (bags: all pairs) unless given."""
    source: tyro.conf.EnumChoicesFromValues[DisplacementSource] = DisplacementSource.MOCAP
    """Of a run: where the moving antenna's path comes from."""
    reply: Path | None = None
    """Of a card's file: the file of the static robot's card, which received the replies."""
    path: Path | None = None
    """Of a card's file: poses of the moving antenna on that card's clock (TUM text: t x y z qx qy qz qw)."""
    card: CsiFileOptions = field(default_factory=CsiFileOptions)
    """What the card's file does not say of itself."""
    reply_card: CsiFileOptions = field(default_factory=CsiFileOptions)
    """What the file of the replies does not say of itself."""
    at: float | None = None
    """Of a bag: draw each pair's bearing nearest to this many seconds after its first, not its sharpest."""
    calibration: Path | None = None
    """Calibration of the bearings made by 'mulan calibrate'."""
    bearings: BearingConfig = field(default_factory=BearingConfig)
    """The estimator."""


def bearings_of_run(run: WsrRun, options: Options) -> list[DrawnBearing]:
    """One bearing a link."""
    names = [link.name for link in run.links]
    if options.link and options.link not in names:
        raise InputError(
            options.file, f"link '{options.link}'", "is not in the run", f"choose from {', '.join(names)}"
        )
    drawn = []
    for link in run.links:
        if options.link not in ("", link.name):
            continue
        bearing = link_bearing(run, link, options.source, options.bearings)
        if bearing is None:
            console.print(f"{escape(link.name)}: too few packets or a straight path, so no bearing")
            continue
        origin = bearing.origin_odom_m if bearing.origin_odom_m is not None else bearing.T_odom_body[:3, 3]
        truth = true_azimuth(run, link, options.source, origin).origin_rad
        title = f"{run.name}, {bearing.observer} → {link.name}, path by {options.source.value}"
        drawn.append(DrawnBearing(title, bearing, truth))
    return drawn


def _truth_in_bag(mission: Mission, bearing: Bearing) -> float | None:
    observer, peer = mission.robot(bearing.observer), mission.robot(bearing.peer)
    if observer.ground_truth is None or peer.ground_truth is None:
        return None
    here, there = (
        se3.interpolate(track.time_s, track.T_world_body, np.array([t]))[0]
        for track, t in ((observer.ground_truth, bearing.time_s), (peer.ground_truth, bearing.peer_time_s))
    )
    to_odom = bearing.T_odom_body @ np.linalg.inv(here) @ there
    target = to_odom[:3, :3] @ peer.wifi_antenna_body_m + to_odom[:3, 3]
    antenna = bearing.T_odom_body[:3, :3] @ observer.wifi_antenna_body_m + bearing.T_odom_body[:3, 3]
    origin = bearing.origin_odom_m if bearing.origin_odom_m is not None else antenna
    return float(np.arctan2(*(target - origin)[[1, 0]]))


def robots_of_cards(options: Options) -> Mission:
    """The robots that a card's file, its replies and a path make.

    Raises:
        InputError: A file cannot be read, or the replies or the path are not given (the file is described).
    """
    if options.reply is not None and options.path is not None:
        robots = card_robots(options.file, options.reply, options.path, options.card, options.reply_card)
        return Mission(robots)
    track = read_csi_file(options.file, options.card)
    dead = "".join(f", antenna {f.antenna + 1} is {f.kind.value}" for f in antenna_faults(track))
    folder = ""
    if options.file.suffix == ".dat" and any(options.file.parent.glob("rx_trajectory_*.csv")):
        folder = f"give its run folder, {options.file.parent}, or "
    raise InputError(
        options.file,
        "recording",
        f"holds one direction of one robot only ({len(track.time_s)} packets{dead})",
        f"{folder}give the other robot's file by --reply and the antenna's path by --path",
    )


def bearings_of_bag(mission: Mission, options: Options) -> list[DrawnBearing]:
    """The sharpest bearing of each pair, or the one nearest to a time."""
    config = replace(options.bearings, keep_profile=KeepProfile.ALL)
    with progress_bar("Bearings") as progress:
        found = estimate_bearings(mission.robots, config, progress)
    pairs: dict[str, list[Bearing]] = {}
    for bearing in found:
        pairs.setdefault(f"{bearing.observer}:{bearing.peer}", []).append(bearing)
    if options.link and options.link not in pairs:
        raise InputError(
            options.file,
            f"pair '{options.link}'",
            "has no bearing",
            f"choose from {', '.join(pairs) or 'none (nobody moved while the other stood still)'}",
        )
    drawn = []
    for pair, bearings in pairs.items():
        if options.link not in ("", pair):
            continue
        first = min(b.time_s for b in bearings)
        if options.at is None:
            chosen = min(bearings, key=lambda b: azimuth_mixture(b).sigma_azimuth_rad)
        else:
            wanted = first + options.at
            chosen = min(bearings, key=lambda b: abs(b.time_s - wanted))
        title = f"{chosen.observer} → {chosen.peer}, {chosen.time_s - first:.1f} s after the first"
        drawn.append(DrawnBearing(title, chosen, _truth_in_bag(mission, chosen)))
    return drawn


def print_hypotheses(drawn: Sequence[DrawnBearing]) -> None:
    """Directions, their sigmas, and what the mixture as a whole claims."""
    table = Table(box=None, header_style="dim", padding=(0, 1))
    for heading in ("", "azimuth", "σ", "elevation", "σ", "weight"):
        table.add_column(heading, justify="right" if heading else "left", no_wrap=True)
    for entry in drawn:
        mixture = azimuth_mixture(entry.bearing)
        _, elevation = azimuth_elevation(entry.bearing.direction_odom)
        table.add_row(f"[bold]{escape(entry.bearing.observer)} → {escape(entry.bearing.peer)}[/]")
        for k in range(len(mixture.weight)):
            sigma_elevation = np.degrees(np.sqrt(entry.bearing.tangent_covariance[k, 1, 1]))
            seen = np.isfinite(sigma_elevation)
            table.add_row(
                f"  direction {k + 1}",
                f"{np.degrees(mixture.mean_rad[k]):.2f}°",
                f"{np.degrees(mixture.sigma_rad[k]):.2f}°",
                f"{np.degrees(elevation[k]):.1f}°" if seen else "unobservable",
                f"{sigma_elevation:.1f}°" if seen else "",
                f"{mixture.weight[k]:.3f}",
            )
        table.add_row("  none of them", "", "", "", "", f"{mixture.outlier_mass:.3f}")
    console.print(table)
    for entry in drawn:
        mixture = azimuth_mixture(entry.bearing)
        arcs = ", ".join(f"{a:.1f}° … {b:.1f}°" for a, b in np.degrees(mixture.interval(0.95)))
        sigma_deg = np.degrees(mixture.sigma_azimuth_rad)
        line = f"{escape(entry.title)}: σ {sigma_deg:.1f}° with outliers, 95 % in {arcs}"
        if entry.true_azimuth_rad is not None:
            off = np.degrees(wrapped(np.array(mixture.mean_rad[0] - entry.true_azimuth_rad)))
            line += f"; truth {np.degrees(entry.true_azimuth_rad):.1f}°, error {off:+.1f}°"
        console.print(line)


def main(arguments: Sequence[str]) -> int:
    """Read, find the directions, draw, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan aoa")
    options = replace(options, bearings=calibrated(options.bearings, options.calibration))
    if not options.file.exists():
        raise InputError(options.file, "recording", "does not exist", "check the path")
    if options.file.suffix == ".npz":
        drawn = bearings_of_run(read_wsr_run(options.file), options)
    elif options.file.is_dir() and any(options.file.glob("*.dat")):
        drawn = bearings_of_run(read_wsr_raw(options.file), options)
    elif options.file.is_file() and options.file.suffix not in _BAG_SUFFIXES:
        drawn = bearings_of_bag(robots_of_cards(options), options)
    else:
        drawn = bearings_of_bag(read_mission(options.file), options)
    if not drawn:
        raise InputError(
            options.file,
            "bearings",
            "there are none",
            "record packets both ways while one robot moves along a curve and the other stands still",
        )
    print_hypotheses(drawn)
    print_faults([entry.bearing for entry in drawn])
    draw_profiles(drawn, options.out)
    console.print(f"Picture: [bold]{options.out}[/]")
    return 0
