"""``mulan fleet keys``: certificates for a base station and its robots."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from mulan.cli.progress import console
from mulan.fleet.keys import make_keys


@dataclass(frozen=True)
class Options:
    """Make the certificates by which base station and robots know each other; robots can be added later."""

    out: Path
    """Folder of the certificates; its authority.key lets anyone add robots, so keep it off them."""
    robots: tuple[str, ...]
    """Names of the robots."""
    hosts: tuple[str, ...] = ("localhost", "127.0.0.1")
    """Names and addresses under which robots reach the base station."""
    days: int = 365
    """How long the certificates are valid."""


def main(arguments: Sequence[str]) -> int:
    """Make them."""
    options = tyro.cli(Options, args=arguments, prog="mulan fleet keys")
    make_keys(options.out, options.robots, options.hosts, options.days)
    console.print(f"Keys: [bold]{options.out}[/]")
    console.print("Each robot needs authority.pem and its own NAME.pem and NAME.key, and nothing else.")
    names = " ".join(options.robots)
    console.print(
        f"Next: [cyan]mulan fleet base --link.endpoint tls/{options.hosts[0]}:7447"
        f" --link.keys {options.out} --ingest.robots {names} --out mission.mcap[/]"
    )
    return 0
