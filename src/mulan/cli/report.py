"""``mulan report``: a run's page."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mulan.cli.progress import console
from mulan.mission.run_folder import RunFolder
from mulan.report.page import write_report


@dataclass(frozen=True)
class Options:
    """Write one self-contained page on whatever a run holds."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder."""


def main(arguments: Sequence[str]) -> int:
    """Write the report."""
    options = tyro.cli(Options, args=arguments, prog="mulan report")
    page = write_report(RunFolder(options.run))
    console.print(f"Report: [bold]{page.resolve()}[/]")
    return 0
