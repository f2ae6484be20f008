"""What each idea adds to or costs the field's quality at equal work, on views kept for validation.

Every idea differs from the library's defaults in one thing. All runs see the same number of samples; the CPU
time of each is reported beside. Lego is scored on its ``val`` split; of any other set frames 0, 8, 16, ...
(the test views) are left out and 4, 12, 20, ... are the validation views.

python benchmarks/quality.py --data $MULAN_DATA/nerf_synthetic_lego --out runs/quality-lego
python benchmarks/quality.py --data $MULAN_DATA/fox --image-size 135 --out runs/quality-fox
"""

import math
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro

from mulan.evaluation.provenance import provenance
from mulan.mission.blender import TRAIN, read_split
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import write_json
from mulan.radiance.config import FieldConfig
from mulan.radiance.engine import RadianceEngine, RayBatch
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_field, choose_march, choose_optimiser
from mulan.reconstruction.held_out import psnr_db
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.sub_pixels import Antialiasing
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import next_rays

VAL = "transforms_val.json"


class Drawing:
    """Pixels at random; towards the end of the training each is two rays."""

    def __init__(self, engine: RadianceEngine, pixels: int) -> None:
        self._engine, self._error = engine, torch.ones(pixels)

    def batch(self, data: ImageTensors, rays: int, pairs: bool, generator: torch.Generator) -> RayBatch:
        """Rays to learn from."""
        return (data.sample_pairs if pairs else data.sample)(rays, generator)


class OffCentreDrawing(Drawing):
    """One ray somewhere in its pixel instead of through the centre."""

    def batch(self, data: ImageTensors, rays: int, pairs: bool, generator: torch.Generator) -> RayBatch:  # noqa: ARG002
        """See :class:`Drawing`; the rays of a pair go their own ways."""
        b = super().batch(data, 2 * rays, True, generator)
        return RayBatch(b.origins[::2], b.directions[::2], b.colours[::2], b.weights[::2], b.image_index[::2])


class ErrorDrawing(Drawing):
    """Half of the single rays by the root of their pixel's last error, the rest at random."""

    def batch(self, data: ImageTensors, rays: int, pairs: bool, generator: torch.Generator) -> RayBatch:
        """See :class:`Drawing`."""
        if pairs:
            return super().batch(data, rays, pairs, generator)
        cumulative = self._error.double().sqrt().cumsum(0)
        uniform = torch.rand(rays // 2, generator=generator, dtype=torch.float64)
        likely = torch.searchsorted(cumulative, uniform * cumulative[-1]).clamp_max(len(cumulative) - 1)
        pixel = torch.cat([likely, torch.randint(len(self._error), (rays - rays // 2,), generator=generator)])
        batch = data.rays(pixel)
        rendered = self._engine.render(batch.origins, batch.directions).colour
        self._error[pixel] = (rendered - batch.colours).square().mean(-1)
        return batch


@dataclass(frozen=True)
class Idea:
    """One departure from the defaults."""

    name: str
    optimiser: Mapping[str, float] = field(default_factory=dict)
    """Options of ``OptimiserConfig`` to change from those chosen for the scene."""
    config: TrainConfig = field(default_factory=TrainConfig)
    average_decay: float | None = None
    """Score a running mean of the parameters over the second half, refreshed every 4 steps."""
    fade_fine_levels: bool = False
    """Weaken grid levels finer than a pixel seen from the median camera."""
    drawing: type[Drawing] = Drawing
    """How rays are drawn."""


IDEAS = (
    Idea("as built"),
    Idea("rays through pixel centres", config=TrainConfig(antialias_share=0)),
    Idea("pairs of rays in the last 0.3", config=TrainConfig(antialias_share=0.3)),
    Idea("pairs of rays from the half", config=TrainConfig(antialias_share=0.5)),
    Idea("pairs of rays from the start", config=TrainConfig(antialias_share=1)),
    Idea("one ray off its pixel's centre", drawing=OffCentreDrawing),
    Idea("rays drawn by error", drawing=ErrorDrawing),
    Idea("Adam beta2 0.999", {"beta2": 0.999}),
    Idea("Adam beta2 0.99", {"beta2": 0.99}),
    Idea("Adam beta2 0.9", {"beta2": 0.9}),
    Idea("Adam beta1 0.8", {"beta1": 0.8}),
    Idea("Adam epsilon 1e-8", {"epsilon": 1e-8}),
    Idea("table's rate 1e-2", {"table_learning_rate": 1e-2}),
    Idea("table's rate 4e-2", {"table_learning_rate": 4e-2}),
    Idea("networks' rate 5e-3", {"network_learning_rate": 5e-3}),
    Idea("networks' rate 2e-2", {"network_learning_rate": 2e-2}),
    Idea("last rate 0.1", config=TrainConfig(final_learning_rate=0.1)),
    Idea("last rate 0.1, mean of weights", config=TrainConfig(final_learning_rate=0.1), average_decay=0.95),
    Idea("mean of weights", average_decay=0.95),
    Idea("fine levels weakened by pixel size", fade_fine_levels=True),
)


@dataclass(frozen=True)
class Options:
    """Train every idea with every seed and score the validation views."""

    data: Path
    """Posed image set."""
    out: Path
    """Folder for quality.json and quality.png."""
    image_size: int = 100
    """Longest image side in pixels."""
    steps: int = 2000
    """Optimiser steps of each run."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """One run each."""
    ideas: tuple[str, ...] = tuple(idea.name for idea in IDEAS)
    """Which of the ideas, by name; 'as built' is always run."""
    views: int = 12
    """Validation views to score, spread over the split."""


@dataclass(frozen=True)
class Photographs:
    """What is learnt from and what is scored."""

    train: tuple[CapturedImage, ...]
    validation: ImageTensors


def read(options: Options) -> Photographs:
    if (options.data / VAL).exists():
        learn, check = read_split(options.data / TRAIN), read_split(options.data / VAL)
    else:
        frames = tuple(enumerate(read_posed_images(options.data, hold_out_every=None).train))
        learn = tuple(frame for i, frame in frames if i % 4)
        check = tuple(frame for i, frame in frames if i % 8 == 4)
    check = check[:: max(1, len(check) // options.views)]
    return Photographs(
        load_captured(learn, options.image_size), ImageTensors(load_captured(check, options.image_size))
    )


def run(photographs: Photographs, options: Options, idea: Idea, seed: int) -> dict[str, float]:
    """Train once; PSNR of the validation views and CPU seconds of the training."""
    space = choose_space(photographs.train)
    sizes = choose_field(options.image_size, len(photographs.train), space.unbounded)
    config = replace(idea.config, image_size=options.image_size, steps=options.steps)
    rays, mean = 256, None
    march = choose_march(options.image_size, space.unbounded, config.quick)
    optimiser = replace(choose_optimiser(space.unbounded, config.quick), **idea.optimiser)
    engine = NativeEngine(sizes, march, space, not space.unbounded, seed, optimiser)
    data, generator = ImageTensors(photographs.train), torch.Generator().manual_seed(seed + 1)
    if idea.fade_fine_levels:
        engine.set_level_weights(level_weights(photographs, sizes, space))
    drawing = idea.drawing(engine, data.drawable_pixels)
    antialiasing = Antialiasing.choose(idea.config.antialias_share, space.unbounded)
    began = time.process_time()
    for step in range(options.steps):
        done = config.fraction_done(step, 0)
        batch = drawing.batch(data, rays, antialiasing.began(done), generator)
        report = engine.train_step(batch, config.learning_rate_factor(done))
        wanted = config.batch_samples_at(done, space.unbounded, on_gpu=False)
        rays = next_rays(rays, report.samples, wanted)
        if idea.average_decay is not None and step % 4 == 3 and done >= 0.5:
            mean = running_mean(mean, engine.state(), idea.average_decay)
    cpu_s = time.process_time() - began
    if mean is not None:
        engine.load_state(mean)
    scores = [
        psnr_db(engine, photographs.validation, i, antialiasing.sub_pixels)
        for i in range(len(photographs.validation))
    ]
    return {"psnr_db": statistics.mean(scores), "cpu_s": cpu_s}


def level_weights(photographs: Photographs, sizes: FieldConfig, space: SceneSpace) -> torch.Tensor:
    """Share of a cell that a pixel's Gaussian leaves, as Zip-NeRF weighs features (Barron et al. 2023).

    One weight a level: lego's cameras stand at one distance, so a weight a sample would be much the same.
    """
    distances_m = [
        float(np.linalg.norm(image.T_world_camera[:3, 3] - np.array(space.centre_m)))
        for image in photographs.train
    ]
    pixel_m = statistics.median(distances_m) / photographs.train[0].camera.fx
    sigma = pixel_m / math.sqrt(12) / (2 * space.radius_m * (2 if space.unbounded else 1))
    cells = torch.tensor([float(sizes.level_resolution(level)) for level in range(sizes.levels)])
    return torch.erf(1 / (math.sqrt(8) * sigma * cells))


def running_mean(
    mean: dict[str, torch.Tensor] | None, state: dict[str, torch.Tensor], decay: float
) -> dict[str, torch.Tensor]:
    """The state with its parameters averaged over earlier ones."""
    if mean is None:
        return state
    for name, value in state.items():
        if value.is_floating_point() and not name.startswith(("exp_avg", "occupancy")):
            value.lerp_(mean[name], decay)
    return state


def summary(runs: dict[str, list[dict[str, float]]]) -> dict[str, Any]:
    """Mean PSNR of each idea and its gain over the defaults, seed by seed."""
    base = runs[IDEAS[0].name]
    result = {}
    for name, own in runs.items():
        gains = [mine["psnr_db"] - theirs["psnr_db"] for mine, theirs in zip(own, base, strict=False)]
        result[name] = {
            "psnr_db": statistics.mean(r["psnr_db"] for r in own),
            "gain_db": statistics.mean(gains),
            "gain_error_db": statistics.stdev(gains) / len(gains) ** 0.5 if len(gains) > 1 else None,
            "cpu_ratio": sum(r["cpu_s"] for r in own) / sum(r["cpu_s"] for r in base[: len(own)]),
            "seeds": len(own),
        }
    return result


def draw_picture(ideas: dict[str, Any], title: str, path: Path) -> None:
    figure, axes = plt.subplots(figsize=(7, 0.35 * len(ideas) + 1))
    gains, errors = ([idea[key] or 0.0 for idea in ideas.values()] for key in ("gain_db", "gain_error_db"))
    axes.barh(list(ideas), gains, xerr=errors, color=["tab:green" if g > 0 else "tab:red" for g in gains])
    axes.invert_yaxis()
    axes.set(xlabel="gain over the defaults [dB]", title=title)
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


def main(options: Options) -> None:
    photographs = read(options)
    options.out.mkdir(parents=True, exist_ok=True)
    chosen = [idea for idea in IDEAS if idea is IDEAS[0] or idea.name in options.ideas]
    runs: dict[str, list[dict[str, float]]] = {idea.name: [] for idea in chosen}
    facts = {"data": options.data.name, "image_size": options.image_size, "steps": options.steps}
    made = {**provenance(options.seeds[0]), "seeds": list(options.seeds)}
    for seed in options.seeds:
        for idea in chosen:
            own = runs[idea.name]
            own.append(run(photographs, options, idea, seed))
            done = {name: each for name, each in runs.items() if each}
            result = {**facts, "provenance": made, "runs": done, "ideas": summary(done)}
            write_json(options.out / "quality.json", result)  # after each run: an hour's work may be stopped
            gain_db = own[-1]["psnr_db"] - runs[IDEAS[0].name][-1]["psnr_db"]
            print(f"seed {seed}, {idea.name}: {own[-1]['psnr_db']:.2f} dB ({gain_db:+.2f})", flush=True)
    title = f"{options.data.name}, {options.image_size} px, {options.steps} steps, seeds {options.seeds}"
    draw_picture(summary(runs), f"{title}\n{made['date']}, {made['machine']}", options.out / "quality.png")


if __name__ == "__main__":
    main(tyro.cli(Options))
