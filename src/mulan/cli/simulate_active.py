"""``mulan simulate --active``: robots that choose their own views, from first photograph to report."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import EnumChoicesFromValues

from mulan.cli.localize import print_accuracy, print_verdict
from mulan.cli.progress import console, progress_bar
from mulan.cli.train import train_run
from mulan.errors import InputError
from mulan.export.extras import extra_module
from mulan.export.video import VideoConfig, export_video
from mulan.localization.accuracy import accuracy
from mulan.localization.run_files import write_localization
from mulan.mission.bag_writer import write_mission
from mulan.mission.nerfstudio import read_transforms, write_transforms
from mulan.mission.run_folder import RunFolder
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.team import TeamConfig
from mulan.planning.team_plan import TeamPlanConfig
from mulan.planning.team_run import EnsembleConfig
from mulan.reconstruction.field_file import load_field
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import UncertaintyWeights
from mulan.report.page import write_report
from mulan.simulation.radio_kind import RadioKind
from mulan.simulation.sionna_config import SionnaConfig
from mulan.simulation.world_kind import WorldKind

FRAMES = 96


@dataclass(frozen=True)
class Options:
    """Robots that choose their own views: move, photograph, measure, localize, learn and plan in a loop.

    They start with a few photographs each and know their poses from odometry and radio only. When the budget
    is spent, the field is learnt from all photographs; the run holds the bag, the report and a video.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Run folder to write."""
    world: EnumChoicesFromValues[WorldKind] = WorldKind.ROOM
    """Which built-in world."""
    scene_file: Annotated[Path | None, tyro.conf.arg(aliases=["--scene"])] = None
    """Mitsuba XML scene (z up, metres, its subject at the origin) instead of a built-in world."""
    radio: EnumChoicesFromValues[RadioKind] = RadioKind.MIRRORS
    """What carries the radio, the walls of the world's box as mirrors or rays traced among all things of
    the scene (pip install 'mulan[sionna]')."""
    sionna: SionnaConfig = field(default_factory=SionnaConfig)
    """With --radio sionna: how rays are traced."""
    robots: int = 3
    """Number of robots."""
    seed: int = 0
    """Source of all randomness."""
    first_photos: int = 4
    """Photographs of each robot before the first choice."""
    steps: int = 8
    """Most choices; the mission ends earlier if no view is worth its way."""
    budget_m: float = 8.0
    """How far each robot may travel after its first photographs."""
    lose: str | None = None
    """A robot that stops answering, and from which choice on: ROBOT@STEP, such as beta@4."""
    held_out: int = 12
    """Test views with true poses."""
    width: int = 128
    """Image width in pixels."""
    height: int = 96
    """Image height in pixels."""
    samples_per_pixel: int = 24
    """Light paths a pixel."""
    time_budget: float = 60.0
    """Seconds of training at the end."""
    frames: int | None = None
    """Pictures of the video along the robots' ways, 0 for none; 96 if not given and the extra 'export' is
    installed."""
    free_space: FreeSpaceConfig = field(default_factory=FreeSpaceConfig)
    """Places each robot can reach."""
    team: TeamConfig = field(default_factory=TeamConfig)
    """Price of travel and radio range."""
    ensemble: EnsembleConfig = field(default_factory=EnsembleConfig)
    """The small fields that plan."""


def _lost(word: str | None) -> tuple[str, int] | None:
    if word is None:
        return None
    robot, at, step = word.partition("@")
    if not at or not step.isdigit() or int(step) < 1:
        raise InputError("--lose", f"'{word}'", "is not ROBOT@STEP", "give a robot and a step, as beta@4")
    return robot, int(step)


def film_frames(asked: int | None) -> int:
    """Pictures of the video; a mission nobody asked to film goes without where no video can be written.

    Raises:
        InputError: Some are asked for and a package is missing, which is better told before the mission.
    """
    if asked == 0:
        return 0
    try:
        extra_module("imageio_ffmpeg", "imageio-ffmpeg", "the video (--frames 0 makes none)")
    except InputError:
        if asked is None:
            return 0
        raise
    return FRAMES if asked is None else asked


def explore(options: Options, run: RunFolder) -> None:
    """Let the team explore; write the bag, poses, posed images and steps.json.

    Raises:
        InputError: An option makes no sense, or the scene file cannot be used.
    """
    # Mitsuba takes a second to load, which --help need not wait for
    from mulan.evaluation.exploration.explore import Exploration, ExplorationConfig, Loss
    from mulan.simulation.from_scene import SceneMissionConfig

    lost = _lost(options.lose)
    scene = SceneMissionConfig(
        robots=options.robots,
        held_out=options.held_out,
        width=options.width,
        height=options.height,
        world=options.world,
        scene_file=options.scene_file,
        radio=options.radio,
        sionna=options.sionna,
        seed=options.seed,
    )
    config = ExplorationConfig(
        scene=scene,
        first_photos=options.first_photos,
        steps=options.steps,
        budget_m=options.budget_m,
        lose=None if lost is None else Loss(*lost),
        plan=TeamPlanConfig(free_space=options.free_space, team=options.team),
        ensemble=options.ensemble,
    )
    config = replace(config, team=replace(config.team, samples_per_pixel=options.samples_per_pixel))
    run.check_writable()
    with progress_bar("Exploring") as progress:
        exploration = Exploration(config, run)
        localization, images = exploration.run(progress)
    mission = exploration.team.mission
    write_mission(mission, run.root / "mission.mcap")
    write_localization(localization, mission, run)
    write_transforms(images, run.transforms)
    for name, left_m in exploration.left_m.items():
        photographs = sum(image.robot_id == name for image in images.train)
        gone = f", lost at step {lost[1]}" if lost is not None and lost[0] == name else ""
        console.print(
            f"{name}: {photographs} photographs, {options.budget_m - left_m:.1f} m travelled{gone}; "
            "no collision"
        )
    print_verdict(localization)
    if figures := accuracy(localization, mission):
        print_accuracy(figures)


def main(arguments: Sequence[str]) -> int:
    """Explore, learn, report, film."""
    options = tyro.cli(Options, args=arguments, prog="mulan simulate --active")
    run = RunFolder(options.out)
    _lost(options.lose)
    frames = film_frames(options.frames)
    explore(options, run)
    run.record_config("simulate --active", asdict(options))
    images = read_transforms(run.transforms)
    training = TrainConfig(
        image_size=max(options.width, options.height), time_budget_s=options.time_budget, seed=options.seed
    )
    train_run(run, images, UncertaintyWeights(), training)
    page = write_report(run)
    if frames > 0:
        engine, description = load_field(run.field)
        film = VideoConfig(path="robots", frames=frames, image_size=2 * max(options.width, 64))
        with progress_bar("Filming") as progress:
            files = export_video(engine, images, film, description.sub_pixels, run.root, progress)
        console.print(f"Video: [bold]{files[0]}[/]")
    elif options.frames is None:
        console.print(
            f"Video: none without ffmpeg; run: pip install 'mulan\\[export]', then"
            f" [cyan]mulan export {options.out} --to video --video.path robots[/]"
        )
    console.print(f"Bag: [bold]{run.root / 'mission.mcap'}[/], steps: [bold]{run.root / 'steps.json'}[/]")
    console.print(f"Report: [bold]{page.resolve()}[/]")
    console.print(f"Next: [cyan]mulan plan {options.out} --rule team[/]")
    return 0
