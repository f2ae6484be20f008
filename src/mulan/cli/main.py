"""``mulan COMMAND``: finds the command's module, runs it, turns user errors into one sentence."""

import importlib
import os
import sys
from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from mulan import __version__
from mulan.errors import InputError
from mulan.reconstruction.torchrun import is_leader, place_of_this_process

COMMANDS = {
    "demo": "Three simulated robots reconstruct a room, from radio to report.",
    "simulate": "Make a mission bag from a 3-D scene or from a posed image set.",
    "import": "Bring in ROS bags with other topics, COLMAP models, trajectories with images.",
    "run": "Localize, train, plan and report on one bag.",
    "aoa": "Draw where a recording's radio signals come from.",
    "calibrate": "Fit what bearings claim to recordings with known geometry.",
    "localize": "Turn a bag's odometry and radio into poses with covariance.",
    "train": "Learn the radiance field from a run or a posed image set.",
    "plan": "Propose the next views for every robot of a run.",
    "render": "Render views of a trained run.",
    "view": "Walk through a trained run in the browser.",
    "fleet": "Robots and a base station over the network.",
    "export": "Write a run for nerfstudio, COLMAP, TUM tools, mesh and video programs.",
    "evaluate": "Run the experiments behind the published numbers.",
    "report": "Write a run's report page.",
    "doctor": "Say what this machine has and what a missing part costs.",
}


_MODULES = {"import": "importing"}  # Python keeps some words to itself


def print_overview() -> None:
    """Name, commands and where to begin."""
    console = Console()
    console.print(f"[bold]mulan {__version__}[/]  one photorealistic 3-D model from a team of robots\n")
    table = Table(box=None, show_header=False, padding=(0, 2))
    for name, purpose in COMMANDS.items():
        table.add_row(f"[cyan]{name}[/]", purpose)
    console.print(table)
    console.print("\nBegin with [cyan]mulan demo[/]; every command explains itself with [cyan]--help[/].")


def run_command(arguments: Sequence[str]) -> int:
    """Run one command line; returns the exit code."""
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        print_overview()
        return 0
    if arguments[0] in ("-V", "--version", "version"):
        print(__version__)
        return 0
    name, *rest = arguments
    if name not in COMMANDS:
        raise InputError("mulan", f"command '{name}'", "is unknown", "see 'mulan --help'")
    if name != "train" and place_of_this_process() is not None:
        raise InputError("torchrun", f"command '{name}'", "runs in one process", "start it without torchrun")
    return importlib.import_module(f"mulan.cli.{_MODULES.get(name, name)}").main(rest)


def main() -> None:
    """Entry point of the ``mulan`` program."""
    # threads that spin while they wait slow a busy machine several times over; must be set before torch loads
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    try:
        sys.exit(run_command(sys.argv[1:]))
    except InputError as error:
        # what goes wrong in one process is told to all, so one of them may speak
        if is_leader():
            console = Console(stderr=True, soft_wrap=True, highlight=False)
            console.print("[red bold]error[/]", escape(str(error)))
        sys.exit(2)
    except KeyboardInterrupt:
        if is_leader():
            print("\nstopped; run the same command again to go on where it was", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # the reader (head, less) went away; leave quietly
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


if __name__ == "__main__":
    main()
