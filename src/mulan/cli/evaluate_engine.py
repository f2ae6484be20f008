"""``mulan evaluate engine``: the engine against its goals, torch and the peers."""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from mulan.cli.progress import console, progress_stages
from mulan.evaluation.engine.goals import Goal, check_goals
from mulan.evaluation.engine.listener import Listener
from mulan.evaluation.engine.peers import PeerConfig
from mulan.evaluation.engine.protocol import PICTURE, EngineBenchmark, EngineBenchmarkConfig
from mulan.evaluation.engine.scenes import engine_scenes
from mulan.evaluation.engine.throughput import ThroughputConfig
from mulan.mission.run_folder import RunFolder
from mulan.radiance.backend import Device


def recordings() -> Path:
    """Folder of the public recordings: MULAN_DATA, or the place beside the source tree."""
    return Path(os.environ.get("MULAN_DATA", "../shared/data"))


@dataclass(frozen=True)
class Options:
    """Quality against training time, throughput, rendering and memory; beside torch and the peers."""

    out: Path
    """Folder to write; metrics.json and psnr.png lie in it."""
    data: Path = field(default_factory=lambda: recordings() / "nerf_synthetic_lego")
    """Posed images of a cut-out object (NeRF-synthetic lego)."""
    fox: Path = field(default_factory=lambda: recordings() / "fox")
    """Posed images of a real place (instant-ngp's fox); every 8th is held out."""
    only: str = ""
    """Parts to measure, separated by commas; the rest of an earlier metrics.json is kept."""
    budget_scale: float = 1.0
    """Multiplies the training budgets; below 1 for a quick look that is no measurement."""
    peer_python: Path | None = None
    """Python of the environment the peers are installed in; without it they are not run."""
    peers: str = ",".join(PeerConfig.names)
    """Which peers, separated by commas; options of a runner's own may follow its name."""
    peer_runners: Path = Path("benchmarks/peers")
    """Folder of the peers' runner scripts; they come with the source tree, not with the package."""
    peer_budget: float = PeerConfig.budget_s
    """Seconds of training for each peer on the object; 0 leaves it out."""
    peer_fox_budget: float = PeerConfig.fox_budget_s
    """Seconds of training for each peer on the real place; 0 leaves it out."""
    peer_timeout: float = PeerConfig.timeout_s
    """Seconds after which a peer is stopped, its evaluations included."""
    torch_budget: float = EngineBenchmarkConfig.torch_budget_s
    """Seconds of training for each of the torch fields."""
    throughput: Annotated[ThroughputConfig, tyro.conf.arg(name="throughput")] = field(
        default_factory=ThroughputConfig
    )
    """Training throughput against torch."""
    device: tyro.conf.EnumChoicesFromValues[Device] = Device.CPU
    """Where our own trainings run; throughput, torch and the peers are measured on the CPU."""
    seed: int = 0
    """Source of all randomness."""


def benchmark(options: Options, listener: Listener) -> EngineBenchmark:
    """The benchmark the options ask for."""
    peers = PeerConfig(
        python=options.peer_python,
        runners=options.peer_runners,
        names=_words(options.peers),
        budget_s=options.peer_budget,
        fox_budget_s=options.peer_fox_budget,
        timeout_s=options.peer_timeout,
    )
    config = EngineBenchmarkConfig(
        throughput=replace(options.throughput, seed=options.seed),
        peers=peers,
        torch_budget_s=options.torch_budget,
        device=options.device,
        seed=options.seed,
    )
    return EngineBenchmark(
        engine_scenes(options.data, options.fox, options.budget_scale),
        config,
        RunFolder(options.out),
        listener,
    )


def print_goals(goals: Sequence[Goal]) -> None:
    """Goals beside what was measured."""
    table = Table(box=None, header_style="dim", padding=(0, 2))
    for heading in ("", "goal", "measured", ""):
        table.add_column(heading, justify="right" if heading else "left")
    for goal in goals:
        bound = "" if goal.goal is None else f"{'≤' if goal.at_most else '≥'} {goal.goal:g} {goal.unit}"
        measured = "not measured" if goal.measured is None else f"{goal.measured:.2f} {goal.unit}"
        verdict = {True: "[green]met[/]", False: "[red]missed[/]", None: ""}[goal.met]
        table.add_row(goal.name, bound, measured, f"{verdict} {goal.note}".strip())
    console.print(table)


def main(arguments: Sequence[str]) -> int:
    """Measure, write, tell."""
    options = tyro.cli(Options, args=arguments, prog="mulan evaluate engine")
    with progress_stages() as stage:
        metrics = benchmark(options, Listener(console.print, stage)).measure(_words(options.only))
    run = RunFolder(options.out)
    run.record_config("evaluate engine", asdict(options))
    print_goals(check_goals(metrics))
    console.print(f"Metrics: [bold]{run.metrics}[/]")
    if (run.root / PICTURE).exists():
        console.print(f"Picture: [bold]{run.root / PICTURE}[/]")
    return 0


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())
