"""``mulan demo``: three simulated robots reconstruct a room, from radio to report."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from mulan.cli.evaluate import print_setups
from mulan.cli.plan import plan
from mulan.cli.progress import console, progress_bar, progress_stages
from mulan.cli.simulate import describe
from mulan.evaluation.setups import compare_setups
from mulan.localization.localize import LocalizationConfig
from mulan.mission.bag_reader import read_mission
from mulan.mission.bag_writer import write_mission
from mulan.mission.run_folder import RunFolder
from mulan.planning.plan import PlanConfig
from mulan.reconstruction.train_config import TrainConfig
from mulan.report.page import write_report
from mulan.simulation.from_scene import SceneMissionConfig, simulate_from_scene
from mulan.wireless.bearing import BearingConfig


@dataclass(frozen=True)
class Options:
    """Three simulated robots reconstruct a room, from radio to report.

    They photograph a rendered room, knowing neither where they started nor how far they drifted; the radios
    give their poses; the field learns the room; the next views are proposed; a page shows it all.
    """

    out: Path = Path("runs/demo")
    """Run folder."""
    time_budget: float = 40.0
    """Seconds of training for each of the three setups compared."""
    photos_per_robot: int = 28
    """Photographs of each robot."""
    width: int = 160
    """Image width in pixels."""
    height: int = 120
    """Image height in pixels."""
    samples_per_pixel: int = 24
    """Light paths a pixel."""
    seed: int = 0
    """Source of all randomness."""

    def mission(self) -> SceneMissionConfig:
        """What the robots do."""
        return SceneMissionConfig(
            photos_per_robot=self.photos_per_robot,
            width=self.width,
            height=self.height,
            samples_per_pixel=self.samples_per_pixel,
            seed=self.seed,
        )


def main(arguments: Sequence[str]) -> int:
    """Run the demo."""
    options = tyro.cli(Options, args=arguments, prog="mulan demo")
    run = RunFolder(options.out)
    bag = run.root / "mission.mcap"
    if bag.exists():
        console.print(f"The robots were here before; their bag is {bag}")
    else:
        with progress_bar("Robots photograph a room") as progress:
            mission = simulate_from_scene(options.mission(), progress)
        write_mission(mission, bag)
    mission = read_mission(bag)
    console.print(describe(mission))
    config = TrainConfig(
        image_size=max(options.width, options.height), time_budget_s=options.time_budget, seed=options.seed
    )
    with progress_stages() as stage:
        metrics = compare_setups(mission, run, config, LocalizationConfig(), BearingConfig(), stage)
    plan(RunFolder(run.root / "uncertainty"), PlanConfig())
    run.record_config("demo", asdict(options))
    page = write_report(run)
    console.print()
    print_setups(metrics)
    console.print(f"\nReport: [bold]{page.resolve()}[/]")
    console.print(
        f"Next: open it in a browser, or [cyan]mulan render {run.root / 'uncertainty'}[/]; "
        "for your own photographs [cyan]mulan simulate --help[/]"
    )
    return 0
