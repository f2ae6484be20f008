"""Which sampling and losses learn an unbounded scene fastest: PSNR against CPU time, as JSON and a picture.

Only training views are looked at: of every 8 frames the first is held out for other measurements and is not
even read, the fifth is predicted, the other six are learnt from.

python benchmarks/unbounded.py --data $MULAN_DATA/fox --out runs/unbounded
"""

import time
from dataclasses import dataclass, field, replace
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
from mulan.radiance.loss import GaussianLikelihoodLoss, HuberLoss
from mulan.radiance.native_engine import NativeConfig, NativeEngine
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_field, choose_march, choose_optimiser
from mulan.reconstruction.held_out import psnr_db
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import next_rays

EVERY, HELD_OUT, VALIDATION = 8, 0, 4


@dataclass(frozen=True)
class Options:
    """Train once for every variant, image size and budget; score the validation views."""

    data: Path
    """Posed image set without a background mask."""
    out: Path
    """Folder for metrics.json and psnr.png."""
    image_sizes: tuple[int, ...] = (135,)
    """Longest image side in pixels."""
    budgets_cpu_s: tuple[float, ...] = (20.0,)
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

    march: dict[str, Any] = field(default_factory=dict)
    grid: dict[str, Any] = field(default_factory=dict)
    optimiser: dict[str, Any] = field(default_factory=dict)


def thinnest(opacity: float) -> Variant:
    return Variant(march={"least_opacity": opacity, "occupancy_threshold": opacity})


def distortion(weight: float) -> Variant:
    return Variant(optimiser={"distortion_weight": weight})


VARIANTS = {
    "as chosen": Variant(),
    "before": Variant(
        march={"least_opacity": 0.03, "occupancy_threshold": 0.01, "min_transmittance": 1e-4},
        optimiser={"distortion_weight": 0.0},
    ),
    "distortion 0": distortion(0.0),
    "distortion 0.01": distortion(0.01),
    "distortion 0.1": distortion(0.1),
    "tails to 1e-4": Variant(march={"min_transmittance": 1e-4}),
    "thinnest sample 0.01": thinnest(0.01),
    "thinnest sample 0.03": thinnest(0.03),
    "thinnest sample 0.1": thinnest(0.1),
    "two cascades": Variant(march={"cascades": 2}),
    "opacity entropy 0.001": Variant(optimiser={"entropy_weight": 1e-3}),
    "Huber 0.1": Variant(optimiser={"loss": HuberLoss(0.1)}),
    "likelihood": Variant(optimiser={"loss": GaussianLikelihoodLoss()}),
    "occupancy decay 0.8": Variant(grid={"decay": 0.8}),
}


@dataclass(frozen=True)
class Split:
    train: tuple[CapturedImage, ...]
    validation: tuple[CapturedImage, ...]


def split_training_views(data: Path, longest_side: int) -> Split:
    frames = read_posed_images(data, hold_out_every=None).train
    validation = [f for i, f in enumerate(frames) if i % EVERY == VALIDATION]
    train = [f for i, f in enumerate(frames) if i % EVERY not in (HELD_OUT, VALIDATION)]
    return Split(load_captured(train, longest_side), load_captured(validation, longest_side))


def run(variant: Variant, split: Split, size: int, budget_cpu_s: float, seed: int, threads: int) -> dict:
    space = choose_space(split.train)
    march = replace(choose_march(size, space.unbounded), **variant.march)
    engine = NativeEngine(
        choose_field(size, len(split.train), space.unbounded),
        march,
        space,
        white_background=not space.unbounded,
        seed=seed,
        optimiser=replace(choose_optimiser(space.unbounded), **variant.optimiser),
        native=NativeConfig(threads=threads, occupancy=NativeGridConfig(**variant.grid)),
    )
    data, validation = ImageTensors(split.train), ImageTensors(split.validation)
    config, sampler = TrainConfig(), torch.Generator().manual_seed(seed + 1)
    rays, steps, samples, spent_s, all_rays = 256, 0, 0, 0.0, 0
    while spent_s < budget_cpu_s:
        began = time.process_time()
        factor = config.learning_rate_factor(spent_s / budget_cpu_s)
        report = engine.train_step(data.sample(rays, sampler), factor)
        all_rays += rays
        rays = next_rays(rays, report.samples, config.samples_a_batch(on_gpu=False))
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
        "split": f"frames mod {EVERY}: {HELD_OUT} never read, {VALIDATION} scored, the others learnt from",
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
