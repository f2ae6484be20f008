"""What lies between a simulated world and the programs of its robots.

One folder stands between the world's program and the robots':

- ``world.json`` when there is a world,
- ``leg_000/<robot>.mcap``, ... what each robot records on a leg, all of a leg at once,
- ``<robot>/wish_001.json``, ... where a robot wants to go on a leg, and whether it measures,
- ``over.json`` when nothing more will happen.
"""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class WorldFolder:
    """Paths between a world and its robots.

    Attributes:
        root: The folder.
    """

    root: Path

    @property
    def world(self) -> Path:
        """Names of the robots."""
        return self.root / "world.json"

    @property
    def over(self) -> Path:
        """There when no leg will follow."""
        return self.root / "over.json"

    @property
    def held_out(self) -> Path:
        """Test views at their true poses."""
        return self.root / "held_out" / "transforms.json"

    def leg(self, number: int) -> Path:
        """What the robots recorded on a leg."""
        return self.root / f"leg_{number:03d}"

    def wish(self, robot: str, leg: int) -> Path:
        """Where a robot wants to go on a leg."""
        return self.root / robot / f"wish_{leg:03d}.json"
