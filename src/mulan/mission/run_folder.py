"""One run is one folder: where each stage's results lie, written so that a kill loses nothing."""

import errno
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mulan.errors import InputError


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file beside its final place and rename it, so readers see the old or the new one, never half.

    Raises:
        InputError: The disk is full or the folder cannot be written; the earlier file is untouched.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
    except OSError as error:
        raise _unwritable(path, error) from error
    temporary = Path(name)
    try:
        write(temporary)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


def _unwritable(path: Path, error: OSError) -> InputError:
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    remedy = "free some space and run the command again" if full else "choose a folder you can write to"
    return InputError(path, "writing", error.strerror or str(error), remedy)


def write_json(path: Path, value: Any) -> None:
    """Write JSON atomically."""
    text = json.dumps(value, indent=1, allow_nan=False)
    write_atomically(path, lambda temporary: temporary.write_text(text + "\n"))


def read_json(path: Path, made_by: str) -> Any:
    """Read a JSON file of a run.

    Raises:
        InputError: It is missing (the sentence names the command that makes it) or is not JSON.
    """
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(path, "file", "does not exist", f"make it with '{made_by}'") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, "JSON", str(error), f"delete it and make it again with '{made_by}'") from error


@dataclass(frozen=True)
class RunFolder:
    """Paths inside one run."""

    root: Path

    @property
    def config(self) -> Path:
        """The options that made the run, by command."""
        return self.root / "config.json"

    @property
    def localization(self) -> Path:
        """Poses, covariances, bearings, accuracy."""
        return self.root / "localization.json"

    @property
    def poses(self) -> Path:
        """``<robot>.tum`` (body poses) and ``<robot>.json`` (camera poses with covariance)."""
        return self.root / "poses"

    @property
    def relative_poses(self) -> Path:
        """Every pair of robots in each other's frames, with covariance."""
        return self.root / "relative_poses.json"

    @property
    def transforms(self) -> Path:
        """The posed image set reconstruction learns from (nerfstudio format)."""
        return self.root / "transforms.json"

    @property
    def images(self) -> Path:
        """Photographs taken out of the bag, one folder a robot, ``held_out`` for test views."""
        return self.root / "images"

    @property
    def checkpoint(self) -> Path:
        """State of an unfinished training."""
        return self.root / "checkpoint.safetensors"

    @property
    def field(self) -> Path:
        """The trained field."""
        return self.root / "field.safetensors"

    @property
    def metrics(self) -> Path:
        """Figures of merit."""
        return self.root / "metrics.json"

    @property
    def history(self) -> Path:
        """Training curve."""
        return self.root / "history.json"

    @property
    def renders(self) -> Path:
        """Held-out views: ``000_true.png``, ``000_rendered.png``, ``000_depth.png``, ..."""
        return self.root / "renders"

    @property
    def plan(self) -> Path:
        """Proposed views."""
        return self.root / "plan.json"

    @property
    def goals(self) -> Path:
        """The chosen views as ROS messages, one a topic."""
        return self.root / "goal_poses.json"

    @property
    def report(self) -> Path:
        """The page a person reads."""
        return self.root / "report.html"

    def check_writable(self) -> None:
        """Make the folder and try it, so that no work is done that cannot be saved.

        Raises:
            InputError: It cannot be made or written.
        """
        probe = self.root / ".writable"
        write_atomically(probe, lambda temporary: temporary.write_text(""))
        probe.unlink(missing_ok=True)

    def record_config(self, command: str, options: dict[str, Any]) -> None:
        """Add one command's options to the run's record; values JSON lacks (paths, infinity) become text."""
        record = read_json(self.config, f"mulan {command}") if self.config.exists() else {}
        record[command] = json.loads(json.dumps(options, default=str), parse_constant=str)
        write_json(self.config, record)
