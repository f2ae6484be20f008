"""Which sampling and schedule learn an object fastest: PSNR against CPU time, as JSON and a picture.

Only training views are looked at: of every 8 the fifth is predicted, the others are learnt from.

python benchmarks/bounded.py --data $MULAN_DATA/nerf_synthetic_lego --out runs/bounded
"""

import dataclasses
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import torch
import tyro

from mulan.evaluation.provenance import provenance
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import write_json
from mulan.radiance.kernels.native_grid import NativeGridConfig
from mulan.radiance.native_engine import NativeConfig, NativeEngine
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_field, choose_march, choose_optimiser
from mulan.reconstruction.held_out import psnr_db
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import next_rays

EVERY, VALIDATION = 8, 4
CORES = 2  # whose time budget the CPU time stands for, however many threads there are


@dataclass(frozen=True)
class Options:
    """Train once for every variant, image size and budget; score the validation views."""

    data: Path
    """Posed image set of an object that was cut out."""
    out: Path
    """Folder for metrics.json and psnr.png."""
    image_sizes: tuple[int, ...] = (100,)
    """Longest image side in pixels."""
    budgets_cpu_s: tuple[float, ...] = (10.0,)
    """CPU seconds of training (all threads); each is a run of its own, with a schedule of that length."""
    variants: tuple[str, ...] = ()
    """Names of the variants to run; all if none is given."""
    seeds: tuple[int, ...] = (0,)
    """Sources of all randomness; figures are means over them."""
    threads: int = 2
    """Threads of the native engine."""


@dataclass(frozen=True)
class Variant:
    """What differs from the program's own choice."""

    field: dict[str, Any] = dataclasses.field(default_factory=dict)
    march: dict[str, Any] = dataclasses.field(default_factory=dict)
    grid: dict[str, Any] = dataclasses.field(default_factory=dict)
    optimiser: dict[str, Any] = dataclasses.field(default_factory=dict)
    train: dict[str, Any] = dataclasses.field(default_factory=dict)


VARIANTS = {
    "as chosen": Variant(),
    "grid forgets fast": Variant(grid={"decay": 0.8}),
    "short warm-up": Variant(grid={"warm_up_refreshes": 3}),
    "thin cells": Variant(march={"occupancy_threshold": 0.01}),
    "all light": Variant(march={"min_transmittance": 1e-4}),
    "table rate 0.02": Variant(optimiser={"table_learning_rate": 2e-2}),
    "table rate 0.04": Variant(optimiser={"table_learning_rate": 4e-2}),
    "256 steps": Variant(march={"steps": 256}),
    "batches of 4096": Variant(train={"batch_samples": 4096}),
    "batches of 16384": Variant(train={"first_batch_samples": 16384}),
    "batches from 4096": Variant(train={"first_batch_samples": 4096}),
    "batches to 32768": Variant(train={"first_batch_samples": 16384, "batch_samples": 32768}),
    "table of 2^17": Variant(field={"log2_table_size": 17}),
    "as if long": Variant(
        march={"occupancy_threshold": 0.01, "min_transmittance": 1e-4},
        optimiser={"table_learning_rate": 2e-2},
        train={"first_batch_samples": 16384},
    ),
    "none of it": Variant(
        march={"steps": 256, "occupancy_threshold": 0.01, "min_transmittance": 1e-4},
        optimiser={"table_learning_rate": 2e-2},
        train={"first_batch_samples": 16384},
    ),
}


@dataclass(frozen=True)
class Split:
    train: tuple[CapturedImage, ...]
    validation: tuple[CapturedImage, ...]


def split_training_views(data: Path, longest_side: int) -> Split:
    frames = read_posed_images(data).train
    validation = [f for i, f in enumerate(frames) if i % EVERY == VALIDATION]
    train = [f for i, f in enumerate(frames) if i % EVERY != VALIDATION]
    return Split(load_captured(train, longest_side), load_captured(validation, longest_side))


def run(variant: Variant, split: Split, size: int, budget_cpu_s: float, seed: int, threads: int) -> dict:
    space = choose_space(split.train)
    config = TrainConfig(image_size=size, time_budget_s=budget_cpu_s / CORES, **variant.train)
    quick = config.quick
    march = replace(choose_march(size, space.unbounded, quick), **variant.march)
    grid = NativeGridConfig(**variant.grid)
    engine = NativeEngine(
        replace(choose_field(size, len(split.train), space.unbounded), **variant.field),
        march,
        space,
        white_background=not space.unbounded,
        seed=seed,
        optimiser=replace(choose_optimiser(space.unbounded, quick), **variant.optimiser),
        native=NativeConfig(threads=threads, occupancy=grid),
    )
    data, validation = ImageTensors(split.train), ImageTensors(split.validation)
    sampler = torch.Generator().manual_seed(seed + 1)
    rays, steps, samples, spent_s, all_rays = 256, 0, 0, 0.0, 0
    while spent_s < budget_cpu_s:
        began = time.process_time()
        done = spent_s / budget_cpu_s
        report = engine.train_step(data.sample(rays, sampler), config.learning_rate_factor(done))
        all_rays += rays
        rays = next_rays(rays, report.samples, config.batch_samples_at(done, space.unbounded, on_gpu=False))
        steps, samples = steps + 1, samples + report.samples
        spent_s += time.process_time() - began
    psnr = [psnr_db(engine, validation, i) for i in range(len(validation))]
    return {
        "psnr_db": sum(psnr) / len(psnr),
        "steps": steps,
        "rays_per_cpu_s": all_rays / spent_s,
        "samples_per_cpu_s": samples / spent_s,
        "occupied": engine.occupied_share,
    }


def mean(runs: list[dict[str, float]]) -> dict[str, float]:
    return {key: sum(r[key] for r in runs) / len(runs) for key in runs[0]}


def main(options: Options) -> None:
    names = options.variants or tuple(VARIANTS)
    result: dict[str, Any] = {
        "data": options.data.name,
        "split": f"training frames mod {EVERY}: {VALIDATION} scored, the others learnt from",
        "provenance": provenance(options.seeds[0]),
        "seeds": list(options.seeds),
    }
    figure, axes = plt.subplots(figsize=(6, 4))
    for size in options.image_sizes:
        split = split_training_views(options.data, size)
        for name in names:
            at: dict[str, Any] = {}
            for budget_s in options.budgets_cpu_s:
                runs = [run(VARIANTS[name], split, size, budget_s, s, options.threads) for s in options.seeds]
                at[f"{budget_s:g}"] = mean(runs) | {"psnr_db_of_seeds": [r["psnr_db"] for r in runs]}
                print(f"{size} px, {budget_s:g} CPU s, {name}: {mean(runs)}", flush=True)
            result.setdefault(f"{size}px", {})[name] = at
            line = [at[key]["psnr_db"] for key in at]
            axes.plot(options.budgets_cpu_s, line, "o-", label=f"{name}, {size} px")
            options.out.mkdir(parents=True, exist_ok=True)
            write_json(options.out / "metrics.json", result)
    axes.set(xscale="log", xlabel="training time [CPU s]", ylabel="PSNR of validation views [dB]")
    axes.legend(fontsize=7)
    figure.savefig(options.out / "psnr.png", dpi=120, bbox_inches="tight")


if __name__ == "__main__":
    main(tyro.cli(Options))
