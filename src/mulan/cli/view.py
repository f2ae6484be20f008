"""``mulan view``: a run in the browser."""

import threading
import webbrowser
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from mulan.cli.progress import console
from mulan.errors import InputError
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.field_file import load_engine
from mulan.report.run_contents import RunContents, read_run
from mulan.viewer.engine_access import FinishedEngine
from mulan.viewer.goals import GoalFile
from mulan.viewer.page import ViewerPage
from mulan.viewer.run_watch import RunWatch
from mulan.viewer.viewer_config import ViewerConfig

_REFRESH_S = 0.5


@dataclass(frozen=True)
class Options:
    """Walk through a trained run in the browser: the field, the robots in it, and what they are unsure of."""

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder."""
    viewer: ViewerConfig = field(default_factory=ViewerConfig)
    """The page."""
    open_browser: bool = True
    """Open the page at once."""
    seconds: float | None = None
    """Close the page after so long; without it, when interrupted."""


def main(arguments: Sequence[str]) -> int:
    """Serve one run until interrupted."""
    options = tyro.cli(Options, args=arguments, prog="mulan view")
    contents = read_run(RunFolder(options.run))
    run = _trained(contents)
    engine = FinishedEngine(load_engine(run.field))
    page = ViewerPage(run, engine, GoalFile(run.root / "goals.json"), options.viewer, contents)

    def field_changed() -> None:
        engine.replace(load_engine(run.field))
        page.redraw()

    changes = {run.field: field_changed, run.plan: page.show_plan, run.transforms: page.show_mission}
    watch = RunWatch(changes)
    console.print(f"Page: [bold]{page.url}[/]   (Ctrl-C closes it)")
    if options.viewer.host not in ("0.0.0.0", "::"):
        console.print("To open it from another computer: [cyan]--viewer.host 0.0.0.0[/]")
    if options.open_browser:
        threading.Thread(target=webbrowser.open, args=(page.url,), daemon=True).start()
    stopped = threading.Event()
    elapsed = 0.0
    try:
        while options.seconds is None or elapsed < options.seconds:
            stopped.wait(_REFRESH_S)
            elapsed += _REFRESH_S
            page.refresh()
    except KeyboardInterrupt:
        pass
    watch.stop()
    page.stop()
    return 0


def _trained(contents: RunContents) -> RunFolder:
    """The run itself, or the setup of an evaluation that is shown first.

    Raises:
        InputError: There is no field.
    """
    run = contents.run
    if contents.headline_setup is not None and not run.field.exists():
        run = contents.setups[contents.headline_setup].run
    if not run.field.exists():
        raise InputError(run.field, "file", "does not exist", f"make it with 'mulan train {run.root}'")
    return run
