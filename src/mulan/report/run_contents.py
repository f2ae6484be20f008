"""What a run folder holds at the moment the report is written."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mulan.errors import InputError
from mulan.mission.run_folder import RunFolder, read_json

_SETUP_TITLES = {
    "oracle": "True poses",
    "wireless": "Wireless poses",
    "uncertainty": "Wireless poses, weighted",
}


@dataclass(frozen=True)
class RunContents:
    """The JSON files of a run, each None where the run has none yet.

    Attributes:
        run: The folder.
        localization, metrics, history, plan, config: Contents of the files of those names.
        setups: Sub-runs of a two-robot evaluation by name, in the order metrics.json gives; empty otherwise.
    """

    run: RunFolder
    localization: dict[str, Any] | None
    metrics: dict[str, Any] | None
    history: list[dict[str, Any]] | None
    plan: dict[str, Any] | None
    config: dict[str, Any] | None
    setups: dict[str, "RunContents"]

    @property
    def robots(self) -> list[str]:
        """Robot names, the anchor's colour first."""
        return list(self.localization["robots"]) if self.localization else []

    @property
    def trained(self) -> dict[str, "RunContents"]:
        """Runs that hold a trained field: the sub-runs of an evaluation by name, else this run itself."""
        return self.setups or {"": self}

    @property
    def headline_setup(self) -> str | None:
        """The setup whose figures stand at the top: the one with uncertainty, else the last."""
        if not self.setups:
            return None
        return "uncertainty" if "uncertainty" in self.setups else list(self.setups)[-1]

    @property
    def headline_metrics(self) -> dict[str, Any]:
        """Figures of merit to show first; empty where nothing was evaluated."""
        if self.headline_setup is not None:
            return setup_metrics(self, self.headline_setup)
        return self.metrics or {}

    def command(self, name: str) -> str:
        """A command line that works on this run, ready to paste.

        An evaluation's fields lie in its setups; planning and rendering take the one shown at the top.
        """
        root = self.run.root
        if name in ("plan", "render") and self.headline_setup is not None:
            root = root / self.headline_setup
        return f"mulan {name} {shlex.quote(str(root))}"


def setup_title(name: str) -> str:
    """How a reader is told of a setup."""
    return _SETUP_TITLES.get(name, name)


def setup_metrics(contents: RunContents, name: str) -> dict[str, Any]:
    """Figures of one setup: those the evaluation summed up, else the sub-run's own."""
    summary = ((contents.metrics or {}).get("setups") or {}).get(name)
    return summary or contents.setups[name].metrics or {}


def read_run(run: RunFolder) -> RunContents:
    """Read whatever the folder holds.

    A two-robot evaluation keeps localization and plan in a sub-run; they are shown as the evaluation's own.

    Raises:
        InputError: The folder does not exist, or a file in it is not JSON of the expected kind.
    """
    if not run.root.is_dir():
        raise InputError(run.root, "run folder", "does not exist", "give the folder a mulan command wrote")
    metrics = _optional(run.metrics, "mulan train", dict)
    setups: dict[str, RunContents] = {}
    for name in (metrics or {}).get("setups") or {}:
        folder = run.root / str(name)
        # a name out of a file must not lead out of the run
        if folder.parent == run.root and folder.is_dir():
            setups[name] = read_run(RunFolder(folder))
    inner = list(setups.values())[::-1]
    return RunContents(
        run=run,
        localization=_optional(run.localization, "mulan localize", dict)
        or next((s.localization for s in inner if s.localization), None),
        metrics=metrics,
        history=_optional(run.history, "mulan train", list),
        plan=_optional(run.plan, "mulan plan", dict) or next((s.plan for s in inner if s.plan), None),
        config=_optional(run.config, "mulan demo", dict),
        setups=setups,
    )


def _optional(path: Path, made_by: str, kind: type) -> Any:
    if not path.exists():
        return None
    value = read_json(path, made_by)
    if not isinstance(value, kind):
        remedy = f"delete it and make it again with '{made_by}'"
        raise InputError(path, "JSON", f"holds a {type(value).__name__}, not a {kind.__name__}", remedy)
    return value
