"""Other people's trainers on the same photographs: each runs under a Python of its own, as a subprocess.

A runner is ``<folder>/<peer>.py`` (dashes or underscores) and takes ``--data SET --image-size N --budget-s T
--eval-every-nth-view K --first-eval-s S --out result.json``; it holds out frames 0, 8, 16, ... of a set that
names no test views. It writes ``name``, ``version``, ``psnr_curve`` ([[seconds on the training clock, mean
PSNR over held-out views 0, K, 2K, ...], ...]), ``rays_per_s``, ``samples_per_s`` and ``notes``, whose
``eval_every_nth_view`` is K.
"""

import json
import math
import os
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mulan.evaluation.engine.curve import THRESHOLD_DB, seconds_to_psnr
from mulan.evaluation.engine.scenes import EngineScene

_POLL_S = 0.2
_LAST_WORDS = 300  # characters of a failed runner's last line kept as the reason


@dataclass(frozen=True)
class PeerConfig:
    """Where the peers are and how long they may run."""

    python: Path | None = None
    """Python of the environment the peers are installed in; without it they are not run."""
    runners: Path = Path("benchmarks/peers")
    """Folder of the runner scripts."""
    names: tuple[str, ...] = ("nerfacto", "tensorf", "opensplat")
    """Which of them; options of a runner's own may follow its name."""
    budget_s: float = 300.0
    """Seconds of training on the object; 0 leaves it out."""
    fox_budget_s: float = 60.0
    """Seconds of training on the real place; 0 leaves it out."""
    every_nth_view: int = 10
    """Test views of the object it is scored on (0, n, 2n, ...), as peers render slowly; ours is then too."""
    fox_every_nth_view: int = 4
    """The same for the real place."""
    timeout_s: float = 900.0
    """Seconds after which a runner is stopped, its evaluations and start included."""


@dataclass(frozen=True)
class PeerTask:
    """One peer on one scene.

    Attributes:
        peer: Its name.
        arguments: Options of its runner's own.
        scene: What it learns.
        budget_s: Seconds on its training clock.
        every_nth_view: Test views it is scored on.
        first_score_s: When it is first scored; the runner spaces the rest.
    """

    peer: str
    arguments: tuple[str, ...]
    scene: EngineScene
    budget_s: float
    every_nth_view: int
    first_score_s: float


def why_no_peers(config: PeerConfig) -> str | None:
    """The reason none can be run, or None."""
    if config.python is None:
        return "not run: no Python of theirs was named (--peer-python)"
    if not config.python.exists():
        return f"not run: {config.python} does not exist"
    if not config.runners.is_dir():
        return f"not run: there is no folder {config.runners} of runner scripts (--peer-runners)"
    return None


def find_runner(folder: Path, peer: str) -> Path | None:
    """The script of a peer."""
    names = (f"{peer}.py", f"{peer.replace('-', '_')}.py")
    return next((folder / name for name in names if (folder / name).is_file()), None)


def run_peer(
    task: PeerTask, config: PeerConfig, folder: Path, progress: Callable[[float, float, str], None]
) -> dict[str, Any]:
    """Run one peer to its end and read what it wrote.

    ``seconds_to_28_db`` is read off its curve by the function used for our own.

    Args:
        task: Who learns what, how long.
        config: Where they are; :func:`why_no_peers` is None for it.
        folder: For its result and its log.
        progress: Hears the seconds that passed.

    Returns:
        Its result, or ``{"not_run": reason}``.
    """
    assert config.python is not None
    runner = find_runner(config.runners, task.peer)
    if runner is None:
        return {"not_run": f"there is no runner for it in {config.runners.name}"}
    stem = f"{task.peer}_{task.scene.name}"
    out, log = folder / f"{stem}.json", folder / f"{stem}.log"
    folder.mkdir(parents=True, exist_ok=True)
    out.unlink(missing_ok=True)
    command = [
        *(str(config.python), str(runner.resolve()), "--data", str(task.scene.data.resolve())),
        *("--image-size", str(task.scene.image_size), "--budget-s", f"{task.budget_s:g}"),
        *("--eval-every-nth-view", str(task.every_nth_view), "--first-eval-s", f"{task.first_score_s:g}"),
        *("--out", str(out.resolve())),
        *task.arguments,
    ]
    failure = _run(command, log, config.timeout_s, task.budget_s, progress)
    if failure is not None:
        return {"not_run": failure}
    try:
        return {**checked_result(json.loads(out.read_text())), "budget_s": task.budget_s}
    except (OSError, ValueError) as error:
        return {"not_run": f"its result cannot be used: {error}"}


def checked_result(result: Any) -> dict[str, Any]:
    """A runner's result with ``seconds_to_28_db`` read off its curve.

    Raises:
        ValueError: There is no curve of finite numbers in order of time.
    """
    if not isinstance(result, dict) or not isinstance(result.get("psnr_curve"), list):
        raise ValueError("it holds no psnr_curve")
    try:
        curve = [(float(seconds), float(psnr_db)) for seconds, psnr_db in result["psnr_curve"]]
    except (TypeError, ValueError):
        raise ValueError("psnr_curve is not a list of pairs of numbers") from None
    if not curve or not all(math.isfinite(value) for point in curve for value in point):
        raise ValueError("psnr_curve is empty or not finite")
    if curve != sorted(curve, key=lambda point: point[0]):
        raise ValueError("psnr_curve is not in order of time")
    return {**result, "psnr_curve": curve, "seconds_to_28_db": seconds_to_psnr(curve, THRESHOLD_DB)}


def _run(
    command: list[str],
    log: Path,
    timeout_s: float,
    budget_s: float,
    progress: Callable[[float, float, str], None],
) -> str | None:
    """Why it failed, or None."""
    # our own packages must not be found by their Python
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    began = time.monotonic()
    with log.open("wb") as output:
        try:
            process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=environment)
        except OSError as error:
            return f"it could not be started: {error.strerror}"
        try:
            while process.poll() is None:
                passed_s = time.monotonic() - began
                if passed_s > timeout_s:
                    return f"stopped after {timeout_s:g} s"
                progress(min(passed_s, 0.99 * budget_s), budget_s, f"{passed_s:.0f} s")
                time.sleep(_POLL_S)
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
    if process.returncode == 0:
        return None
    if process.returncode < 0:
        return f"somebody ended it with signal {-process.returncode}"
    words = log.read_text(errors="replace").strip().splitlines() or ["it said nothing"]
    return f"it ended with code {process.returncode}: {words[-1][-_LAST_WORDS:]}"
