"""A view a person asks a robot to take: the visitor's own camera becomes the goal."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.mission.run_folder import read_json, write_json


@runtime_checkable
class GoalSink(Protocol):
    """Where picked goals go: a file of the run, or the robots themselves."""

    def accept(self, robot: str, T_world_camera: Float[NDArray, "4 4"]) -> str:
        """Take a goal; returns what became of it, in words for the page."""
        ...


@dataclass(frozen=True)
class GoalFile:
    """Goals kept in a file beside the run, the latest a robot.

    Attributes:
        path: ``goals.json``.
    """

    path: Path

    def accept(self, robot: str, T_world_camera: Float[NDArray, "4 4"]) -> str:
        """Write the goal.

        Raises:
            InputError: The file is damaged or cannot be written.
        """
        goals: dict[str, Any] = read_json(self.path, "mulan view") if self.path.exists() else {}
        goals[robot] = {"T_world_camera": np.round(T_world_camera, 6).tolist()}
        write_json(self.path, goals)
        return f"written to {self.path.name}"
