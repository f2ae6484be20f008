"""``mulan simulate``: a mission bag from a 3-D scene or from a posed image set."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro
from tyro.conf import EnumChoicesFromValues

from mulan.cli import simulate_active
from mulan.cli.progress import console, progress_bar
from mulan.errors import InputError
from mulan.mission.bag_writer import write_mission
from mulan.mission.image_sets import read_posed_images
from mulan.mission.types import Mission
from mulan.simulation.from_images import ImageMissionConfig, simulate_from_images
from mulan.simulation.radio_kind import RadioKind
from mulan.simulation.recording import SensorConfig
from mulan.simulation.sionna_config import SionnaConfig
from mulan.simulation.timeline import TourConfig
from mulan.simulation.world_kind import WorldKind


@dataclass(frozen=True)
class Options:
    """Make a mission bag: from posed photographs (--images) or, without them, from a rendered world."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The bag to write, ending in .mcap."""
    images: Path | None = None
    """Posed images to share, a folder or transforms.json (Blender, nerfstudio, instant-ngp)."""
    world: EnumChoicesFromValues[WorldKind] = WorldKind.ROOM
    """Without --images: which built-in world to photograph."""
    scene_file: Annotated[Path | None, tyro.conf.arg(aliases=["--scene"])] = None
    """Mitsuba XML scene (z up, metres, its subject at the origin) instead of a built-in world."""
    radio: EnumChoicesFromValues[RadioKind] = RadioKind.MIRRORS
    """Without --images: what carries the radio, the walls of the world's box as mirrors or rays traced
    among all things of the scene (pip install 'mulan[sionna]')."""
    sionna: SionnaConfig = field(default_factory=SionnaConfig)
    """With --radio sionna: how rays are traced."""
    active: bool = False
    """The robots choose their own views in a closed loop, and a whole run comes out; it has
    options of its own, see 'mulan simulate --active --help'."""
    robots: int = 2
    """Number of robots."""
    seed: int = 0
    """Source of all randomness."""
    hold_out_every: int = 8
    """With --images: every n-th image becomes a test view where the set names none."""
    metres_per_unit: float = 1.0
    """With --images: size of one unit of the set's poses."""
    split: Literal["azimuth", "random", "alternate"] = "azimuth"
    """With --images: who takes which photograph."""
    room: Literal["auto", "none"] = "auto"
    """With --images: walls that reflect the radio, or free space."""
    photos_per_robot: int = 32
    """Without --images: photographs of each robot."""
    width: int = 192
    """Without --images: image width in pixels."""
    height: int = 144
    """Without --images: image height in pixels."""
    samples_per_pixel: int = 48
    """Without --images: light paths a pixel."""
    tour: TourConfig = field(default_factory=TourConfig)
    """Pace of the robots."""
    sensors: SensorConfig = field(default_factory=SensorConfig)
    """Noise of odometry, WiFi and UWB."""


def simulate(options: Options) -> Mission:
    """Make the mission the options describe."""
    if options.images is not None:
        if options.scene_file is not None:
            raise InputError("options", "--scene-file", "and --images exclude each other", "give one")
        if options.radio is RadioKind.SIONNA:
            raise InputError("options", "--radio sionna", "needs a scene", "leave --images out")
        images = read_posed_images(options.images, options.hold_out_every)
        console.print(f"{len(images.train)} photographs to share, {len(images.test)} held out")
        config = ImageMissionConfig(
            robots=options.robots,
            split=options.split,
            metres_per_unit=options.metres_per_unit,
            room=options.room,
            seed=options.seed,
            tour=options.tour,
            sensors=options.sensors,
        )
        return simulate_from_images(images, config)
    from mulan.simulation.from_scene import SceneMissionConfig, simulate_from_scene

    scene_config = SceneMissionConfig(
        robots=options.robots,
        photos_per_robot=options.photos_per_robot,
        width=options.width,
        height=options.height,
        samples_per_pixel=options.samples_per_pixel,
        world=options.world,
        scene_file=options.scene_file,
        radio=options.radio,
        sionna=options.sionna,
        seed=options.seed,
        tour=options.tour,
        sensors=options.sensors,
    )
    with progress_bar("Photographing") as progress:
        return simulate_from_scene(scene_config, progress)


def describe(mission: Mission) -> str:
    """One line on what a mission holds."""
    photos = sum(len(robot.photos) for robot in mission.robots)
    packets = sum(len(track.time_s) for robot in mission.robots for track in robot.csi.values())
    ranges = sum(len(track.time_s) for robot in mission.robots for track in robot.ranges.values())
    held_out = f", {len(mission.held_out.photos)} held-out views" if mission.held_out else ""
    names = ", ".join(robot.name for robot in mission.robots)
    return f"{names}: {photos} photographs{held_out}, {packets} WiFi packets, {ranges} UWB ranges"


def main(arguments: Sequence[str]) -> int:
    """Simulate and write the bag."""
    if "--active" in arguments:
        return simulate_active.main([word for word in arguments if word != "--active"])
    options = tyro.cli(Options, args=arguments, prog="mulan simulate")
    mission = simulate(options)
    write_mission(mission, options.out)
    console.print(describe(mission))
    console.print(f"Bag: [bold]{options.out}[/] ({options.out.stat().st_size / 1e6:.1f} MB)")
    console.print(f"Next: [cyan]mulan run {options.out} --out runs/{options.out.stem}[/]")
    return 0
