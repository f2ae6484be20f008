"""``mulan plan``: where each robot should look next."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mulan.cli.progress import console, progress_bar
from mulan.mission.run_folder import RunFolder
from mulan.planning.candidates import CandidateConfig
from mulan.planning.plan import PlanConfig
from mulan.planning.pose_growth import DriftConfig
from mulan.planning.run_files import plan_run
from mulan.planning.score import LiteralPosterior, PropagatedPosterior
from mulan.reconstruction.field_file import load_engine


@dataclass(frozen=True)
class Options:
    """Propose the next view of every robot of a trained run."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder."""
    posterior: Literal["propagated", "literal"] = "propagated"
    """How pose uncertainty enters the score: propagated to colour, or the paper's formula as printed."""
    columns: int = 32
    """Rays across a candidate's image; the rows follow from its aspect."""
    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    """Where a robot could go."""
    drift: DriftConfig = field(default_factory=DriftConfig)
    """What odometry loses on the way."""

    def config(self) -> PlanConfig:
        """The planner's options."""
        posterior = LiteralPosterior() if self.posterior == "literal" else PropagatedPosterior()
        return PlanConfig(self.candidates, self.drift, posterior, self.columns)


def plan(run: RunFolder, config: PlanConfig) -> None:
    """Score the candidates, write plan.json and plan.png, say where to go."""
    engine = load_engine(run.field)
    with progress_bar("Planning") as progress:
        chosen = plan_run(run, engine, config, progress)
    for robot in chosen.robots:
        if robot.best is None:
            console.print(f"{robot.robot.robot}: nowhere free to go")
            continue
        x, y, z = robot.T_world_candidate[robot.best][:3, 3]
        console.print(
            f"{robot.robot.robot}: go to ({x:.2f}, {y:.2f}, {z:.2f}) m, best of {len(robot.score)} candidates"
        )


def main(arguments: Sequence[str]) -> int:
    """Plan one run."""
    options = tyro.cli(Options, args=arguments, prog="mulan plan")
    run = RunFolder(options.run)
    plan(run, options.config())
    run.record_config("plan", asdict(options))
    console.print(f"Plan: [bold]{run.plan}[/], picture: [bold]{run.plan.with_suffix('.png')}[/]")
    console.print(f"Next: [cyan]mulan report {options.run}[/]")
    return 0
