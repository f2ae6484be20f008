"""How every peer is measured: the training clock, the score, and the JSON that comes out."""

import argparse
import json
import os
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scene import Scene, View, read_scene

TARGET_DB = 28.0


@dataclass
class Result:
    """What one peer did; times are seconds on the training clock."""

    name: str
    version: str
    psnr_curve: list[tuple[float, float]] = field(default_factory=list)
    rays_per_s: float | None = None
    samples_per_s: float | None = None
    seconds_to_28_db: float | None = None
    notes: dict[str, object] = field(default_factory=dict)

    def finish(self, out: Path) -> None:
        """Fill in the time to the target and write the file beside its place, then rename it."""
        self.seconds_to_28_db = seconds_to(self.psnr_curve, TARGET_DB)
        out.parent.mkdir(parents=True, exist_ok=True)
        part = out.with_name(out.name + ".part")
        part.write_text(json.dumps(asdict(self), indent=1) + "\n")
        part.replace(out)
        print(f"{self.name}: 28 dB after {self.seconds_to_28_db} s; {out}", flush=True)


class Peer(Protocol):
    """A learner of radiance fields that can be stepped and rendered."""

    name: str
    version: str

    def step(self) -> tuple[int, int]:
        """One optimiser step; (rays, samples along them that a network evaluated)."""
        ...

    def render(self, view: View) -> NDArray[np.float32]:
        """Colours (h, w, 3) of a test view over white."""
        ...

    def notes(self) -> dict[str, object]:
        """What a reader must know to judge the figures."""
        ...


class TrainingClock:
    """Runs only inside ``with``: seconds of wall time, or of CPU time a thread on a shared machine."""

    def __init__(self, kind: str, threads: int) -> None:
        self.seconds = 0.0
        self._now = time.perf_counter if kind == "wall" else lambda: time.process_time() / threads

    def __enter__(self) -> None:
        self._began = self._now()

    def __exit__(self, *_: object) -> None:
        self.seconds += self._now() - self._began


def parser(description: str) -> argparse.ArgumentParser:
    """The options common to all peers."""
    options = argparse.ArgumentParser(description=description)
    options.add_argument("--data", type=Path, required=True, help="image set: Blender or nerfstudio layout")
    options.add_argument("--out", type=Path, required=True, help="JSON file to write")
    options.add_argument(
        "--image-size", type=int, default=None, help="longest side [px]; 100, 480 for photos"
    )
    options.add_argument("--hold-out-every", type=int, default=8, help="sets that name no test views")
    options.add_argument("--budget-s", type=float, default=300.0, help="training time")
    options.add_argument("--stop-at-db", type=float, default=None, help="end early at this PSNR")
    options.add_argument("--eval-every-nth-view", type=int, default=10, help="score test views 0, k, 2k, ...")
    options.add_argument(
        "--first-eval-s", type=float, default=10.0, help="first evaluation; later ones ×1.25"
    )
    options.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    options.add_argument("--clock", choices=("wall", "cpu"), default="wall", help="cpu: CPU time / threads")
    options.add_argument("--seed", type=int, default=0)
    return options


def scene_of(options: argparse.Namespace) -> Scene:
    """The image set at the size asked for."""
    size = options.image_size
    if size is None:
        size = 100 if (options.data / "transforms_train.json").exists() else 480
    return read_scene(options.data, size, options.hold_out_every)


def common_notes(scene: Scene, options: argparse.Namespace) -> dict[str, object]:
    """Setting of a run, for the JSON."""
    return {
        "scene": scene.name,
        "image": [scene.camera.width, scene.camera.height],
        "train_views": len(scene.train),
        "test_views": len(scene.test),
        "eval_every_nth_view": options.eval_every_nth_view,
        "views_scored": len(scene.test[:: options.eval_every_nth_view]),
        "clock": options.clock,
        "threads": options.threads,
        "psnr": "mean over scored views of each view's PSNR; evaluation is off the clock",
        "seconds_to_28_db": "linear between the two evaluations around 28 dB",
    }


def measure(peer: Peer, scene: Scene, options: argparse.Namespace) -> Result:
    """Train for the budget, scoring at geometrically spaced times off the clock."""
    result = Result(peer.name, peer.version, notes=common_notes(scene, options))
    clock = TrainingClock(options.clock, options.threads)
    views = scene.test[:: options.eval_every_nth_view]
    steps = rays = samples = 0
    due_s = min(options.first_eval_s, options.budget_s)
    while True:
        with clock:
            step_rays, step_samples = peer.step()
        steps, rays, samples = steps + 1, rays + step_rays, samples + step_samples
        if clock.seconds < due_s:
            continue
        psnr = float(np.mean([psnr_db(peer.render(view), view.over_white) for view in views]))
        result.psnr_curve.append((round(clock.seconds, 3), round(psnr, 3)))
        print(f"{peer.name}: {clock.seconds:.1f} s, {steps} steps, {psnr:.2f} dB", flush=True)
        reached = options.stop_at_db is not None and psnr >= options.stop_at_db
        if clock.seconds >= options.budget_s or reached:
            break
        due_s = min(clock.seconds * 1.25, options.budget_s)
    result.rays_per_s = rays / clock.seconds
    result.samples_per_s = samples / clock.seconds if samples else None
    result.notes |= peer.notes() | {"steps": steps, "s_per_step": clock.seconds / steps}
    return result


def psnr_db(rendered: NDArray[np.float32], photograph: NDArray[np.float32]) -> float:
    """PSNR of colours in [0, 1]."""
    error = np.clip(rendered, 0, 1).astype(np.float64) - photograph
    return float(-10 * np.log10(np.mean(error**2)))


def seconds_to(curve: list[tuple[float, float]], target_db: float) -> float | None:
    """First time the curve reaches a PSNR, linear between its points; None if it never does."""
    before: tuple[float, float] | None = None
    for at_s, psnr in curve:
        if psnr >= target_db:
            if before is None:
                return at_s
            return before[0] + (at_s - before[0]) * (target_db - before[1]) / (psnr - before[1])
        before = (at_s, psnr)
    return None
