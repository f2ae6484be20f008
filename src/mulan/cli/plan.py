"""``mulan plan``: where each robot should look next."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mulan.cli.progress import console, progress_bar
from mulan.mission.run_folder import RunFolder
from mulan.planning.candidates import CandidateConfig
from mulan.planning.free_space import FreeSpaceConfig
from mulan.planning.plan import PlanConfig
from mulan.planning.pose_growth import DriftConfig
from mulan.planning.radio_fix import RadioFixConfig
from mulan.planning.run_files import plan_run
from mulan.planning.score import LiteralPosterior, PropagatedPosterior
from mulan.planning.team import TeamConfig
from mulan.planning.team_plan import TeamPlanConfig
from mulan.planning.team_run import TEAM_LOOKS, EnsembleConfig, TeamRunConfig, plan_team_run
from mulan.reconstruction.field_file import load_field


@dataclass(frozen=True)
class Options:
    """Propose the next view of every robot of a trained run."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder."""
    rule: Literal["propagated", "literal", "team"] = "propagated"
    """How views are judged: the paper's fall of the learned variance on the ring, each robot alone, with pose
    uncertainty propagated to colour or in the formula as printed; or by new directions and the disagreement
    of small fields, jointly for the team (slower: the small fields are learnt first)."""
    columns: int | None = None
    """Rays across a candidate's image; the rows follow from its aspect. 32 if not given, 16 with --rule
    team."""
    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    """The ring of views about each robot."""
    drift: DriftConfig = field(default_factory=DriftConfig)
    """What odometry loses on the way."""
    free_space: FreeSpaceConfig = field(default_factory=FreeSpaceConfig)
    """With --rule team, places beyond the ring."""
    radio: RadioFixConfig = field(default_factory=RadioFixConfig)
    """With --rule team, what the radio will tell there about the pose."""
    team: TeamConfig = field(default_factory=TeamConfig)
    """With --rule team, price of travel and radio range."""
    ensemble: EnsembleConfig = field(default_factory=EnsembleConfig)
    """With --rule team, the small fields."""

    def config(self) -> TeamRunConfig | PlanConfig:
        """The planner's options."""
        if self.rule == "team":
            plan = TeamPlanConfig(self.candidates, self.free_space, self.drift, self.radio, self.team)
            looks = TEAM_LOOKS
            if self.columns is not None:
                looks = replace(looks, columns=self.columns, chosen_columns=2 * self.columns)
            return TeamRunConfig(plan, self.ensemble, looks)
        posterior = LiteralPosterior() if self.rule == "literal" else PropagatedPosterior()
        return PlanConfig(self.candidates, self.drift, posterior, self.columns or PlanConfig.columns)


def plan(run: RunFolder, config: TeamRunConfig | PlanConfig) -> None:
    """Score the candidates, write plan.json and plan.png, say where to go."""
    engine, description = load_field(run.field)
    with progress_bar("Planning") as progress:
        if isinstance(config, TeamRunConfig):
            chosen = plan_team_run(run, engine, description.space, config, progress)
        else:
            chosen = plan_run(run, engine, config, progress)
    for robot in chosen.robots:
        if robot.best is None:
            why = "no view is worth the way" if len(robot.score) else "nowhere free to go"
            console.print(f"{robot.robot.robot}: {why}")
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
    console.print(f"Goals as geometry_msgs/PoseStamped: [bold]{run.goals}[/]")
    console.print(f"Next: [cyan]mulan report {options.run}[/]")
    return 0
