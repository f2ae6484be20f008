"""``mulan fleet demo``: robots, base station and page as separate processes on this machine."""

import webbrowser
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import tyro
from rich.markup import escape

from mulan.cli.progress import console, progress_bar
from mulan.fleet.demo import DemoConfig, FleetDemo
from mulan.report.page import write_report


@dataclass(frozen=True)
class Options:
    """Three simulated robots drive, a base station localizes them, learns and tells them where to look."""

    demo: Annotated[DemoConfig, tyro.conf.arg(name="")]
    """The demo."""
    open_browser: bool = True
    """Open the page if there is a browser."""


def main(arguments: Sequence[str]) -> int:
    """Run the demo."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet demo")

    def page_is_open(url: str) -> None:
        console.print(f"Page: [bold]{url}[/]")
        if options.open_browser:
            webbrowser.open(url)

    demo = FleetDemo(options.demo, lambda text: console.print(f"[dim]{escape(text)}[/]"))
    demo.drive(page_is_open)
    with progress_bar("Learning from the finished bag") as progress:
        metrics = demo.judge(progress)
    demo.run.record_config("fleet demo", asdict(options.demo))
    page = write_report(demo.run)
    live, goals = metrics["live"], sum(metrics["goals_gone_to"].values())
    console.print(
        f"Live: [bold]{live['psnr_db']:.2f} dB[/] from {metrics['photographs']} photographs, {goals} of the"
        f" ways to goals, after {live['train_seconds']:.0f} s and {live['steps']} steps of training"
    )
    if "offline" in metrics:
        offline = metrics["offline"]
        console.print(
            f"From the finished bag: {offline['psnr_db']:.2f} dB after {offline['train_seconds']:.0f} s and"
            f" {offline['steps']} steps"
        )
    console.print(f"Report: [bold]{page.resolve()}[/]")
    console.print(f"Next: [cyan]mulan view {demo.run.root}[/]")
    return 0
