"""Structure from motion over all robots' photographs by COLMAP, whatever comes of it."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.evaluation.table2.colmap_process import STEPS
from mulan.mission.colmap.model import ColmapModel
from mulan.mission.colmap.read_model import read_model
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import read_json, write_json

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


@dataclass(frozen=True)
class ColmapConfig:
    """How COLMAP is run: on the CPU, exhaustive matching, each robot's lens known and kept."""

    features: int = 4096
    """Most features of a photograph."""
    threads: int = -1
    """Threads; -1 = one a core."""
    most_seconds: float = 3600.0
    """After so long it is stopped, and has failed."""


@dataclass(frozen=True)
class ColmapMap:
    """The largest map COLMAP made of a set of photographs.

    Attributes:
        T_map_camera: Camera poses (OpenGL axes) by the photograph's number; the map's scale is arbitrary.
        of: Photographs it was given.
        maps: Separate maps it ended with.
        seconds: It took.
        why_not: Why there is no map, in a few words; None if there is one.
    """

    T_map_camera: Mapping[int, Float[NDArray, "4 4"]]
    of: int
    maps: int
    seconds: float
    why_not: str | None = None

    def record(self) -> dict[str, Any]:
        """Plain values for a report."""
        figures = {"placed": len(self.T_map_camera), "of": self.of, "maps": self.maps}
        return {**figures, "seconds": self.seconds, "why_not": self.why_not}


def colmap_map(
    images: PosedImageSet, folder: Path, config: ColmapConfig, seed: int, progress: Progress
) -> ColmapMap:
    """Let COLMAP place the training photographs relative to each other; their poses are not used.

    Args:
        images: Photographs, every robot's in a folder of its own below one.
        folder: For COLMAP's files; a map finished there earlier from the same photographs is kept.
        config: Options.
        seed: Of its random sampling; with one thread it makes the result repeatable.
        progress: Told the steps.
    """
    photographs = Path(os.path.commonpath([image.path.parent for image in images.train]))
    names = [image.path.relative_to(photographs).as_posix() for image in images.train]
    job = _job(images, photographs, names, config, seed)
    found = folder / "colmap.json"
    if found.exists():
        kept = read_json(found, "mulan evaluate table2")
        if kept["job"] == _digest(job):
            return _read(folder, names, kept["seconds"], kept["why_not"])
    if find_spec("pycolmap") is None:
        return ColmapMap({}, len(names), 0, 0.0, "pycolmap is not installed (pip install mulan[metrics])")
    shutil.rmtree(folder, ignore_errors=True)
    write_json(folder / "job.json", job)
    began = time.perf_counter()
    why_not = _run(folder, config.most_seconds, progress)
    seconds = time.perf_counter() - began
    write_json(found, {"job": _digest(job), "seconds": seconds, "why_not": why_not})
    return _read(folder, names, seconds, why_not)


def _job(
    images: PosedImageSet, photographs: Path, names: list[str], config: ColmapConfig, seed: int
) -> dict[str, Any]:
    cameras: dict[tuple[str, str], list[str]] = {}
    for image, name in zip(images.train, names, strict=True):
        c = image.camera
        lens = ",".join(f"{number:.9g}" for number in (c.fx, c.fy, c.cx, c.cy, c.k1, c.k2, c.p1, c.p2))
        cameras.setdefault((image.robot_id or "", lens), []).append(name)
    return {
        "photographs": str(photographs.resolve()),
        "cameras": [{"lens": lens, "names": own} for (_, lens), own in cameras.items()],
        "seed": seed,
        **asdict(config),
    }


def _digest(job: Mapping[str, Any]) -> str:
    sizes = [
        (Path(job["photographs"]) / name).stat().st_size for one in job["cameras"] for name in one["names"]
    ]
    options = {key: value for key, value in job.items() if key not in ("photographs", "most_seconds")}
    return hashlib.sha256(json.dumps([options, sizes], sort_keys=True).encode()).hexdigest()[:16]


def _run(folder: Path, most_seconds: float, progress: Progress) -> str | None:
    """Run COLMAP; why it failed, if it did."""
    command = [sys.executable, "-m", "mulan.evaluation.table2.colmap_process", str(folder)]
    stopped = threading.Event()
    with (
        (folder / "colmap.log").open("wb") as log,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log) as process,
    ):

        def stop() -> None:
            stopped.set()
            process.kill()

        timer = threading.Timer(most_seconds, stop)
        timer.start()
        try:
            assert process.stdout is not None  # asked for above
            for line in process.stdout:
                step = line.decode(errors="replace").strip()
                if step in STEPS:
                    progress(STEPS.index(step), len(STEPS), f"COLMAP, {step}")
            code = process.wait()
        except BaseException:
            process.kill()
            raise
        finally:
            timer.cancel()
    if stopped.is_set():
        return f"COLMAP was stopped after {most_seconds:g} s"
    if code != 0:
        return f"COLMAP ended with code {code}: {_last_words(folder / 'colmap.log')}"
    return None


def _last_words(log: Path) -> str:
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    return lines[-1][:200] if lines else "it said nothing"


def _read(folder: Path, names: list[str], seconds: float, why_not: str | None) -> ColmapMap:
    if why_not is not None:
        return ColmapMap({}, len(names), 0, seconds, why_not)
    try:
        models = [read_model(path) for path in sorted((folder / "maps").iterdir()) if path.is_dir()]
    except InputError as error:
        return ColmapMap({}, len(names), 0, seconds, f"COLMAP's map cannot be read: {error}")
    if not models:
        return ColmapMap({}, len(names), 0, seconds, "COLMAP found no map")
    largest: ColmapModel = max(models, key=lambda model: len(model.images))
    number = {name: i for i, name in enumerate(names)}
    placed = {number[image.name]: image.T_world_camera for image in largest.images}
    return ColmapMap(placed, len(names), len(models), seconds)
