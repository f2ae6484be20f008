"""Quality against training time on a GPU, and nerfacc's NGP example on the same GPU: JSON and a picture.

python benchmarks/gpu.py --data $MULAN_DATA/nerf_synthetic_lego --out runs/gpu

With ``--peer-python`` and ``--nerfacc-examples`` (the ``examples`` folder of nerfacc's repository; it needs
tiny-cuda-nn too) the example runs beside it. Kernels are compiled before the clock starts.
"""

import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import torch
import tyro

from mulan.evaluation.provenance import provenance
from mulan.mission.image_sets import read_posed_images
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.radiance.backend import Device
from mulan.radiance.gpu.find_gpu import find_gpu
from mulan.reconstruction.reconstruct import reconstruct
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import NoWeights

WARM_UP_STEPS = 64  # enough for several occupancy refreshes, so that every kernel has been compiled
GOAL_DB, GOAL_S = 35.0, 60.0
NERFACC_LINE = re.compile(
    r"elapsed_time=([\d.]+)s \| step=(\d+) .*?n_rendering_samples=(\d+) \| num_rays=(\d+)", re.DOTALL
)


@dataclass(frozen=True)
class Options:
    """Train once for every time budget, score all held-out views."""

    data: Path
    """Posed image set."""
    out: Path
    """Folder for metrics.json, psnr.png and the runs."""
    image_size: int = 800
    """Longest image side in pixels; smaller photographs stay as they are."""
    budgets_s: tuple[float, ...] = (5.0, 20.0, 60.0)
    """Seconds of training; each is a run of its own with a schedule of that length."""
    batch_samples: int | None = None
    """Field evaluations a step; the engine's own number if not given."""
    seed: int = 0
    """Source of all randomness."""
    peer_python: Path | None = None
    """Python that has nerfacc and what its examples need."""
    nerfacc_examples: Path | None = None
    """Folder of nerfacc's examples."""


def train(images: PosedImageSet, config: TrainConfig, folder: Path) -> dict[str, Any]:
    return reconstruct(images, NoWeights(), config, RunFolder(folder), lambda *_: None)


def nerfacc(python: Path, examples: Path, data: Path) -> dict[str, Any]:
    """What nerfacc's example prints; its samples are those left after it dropped what no light reaches."""
    script = examples / "train_ngp_nerf_occ.py"
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "lego").symlink_to(data.resolve())
        command = [str(python), str(script), "--data_root", folder, "--scene", "lego"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=examples)
    lines = NERFACC_LINE.findall(done.stdout)
    if done.returncode or len(lines) < 2:
        return {"not_run": (done.stderr or done.stdout)[-500:]}
    (began, first, _, _), (ended, last, samples, rays) = lines[0], lines[-1]
    steps_per_s = (int(last) - int(first)) / (float(ended) - float(began))
    return {
        "steps_per_s": steps_per_s,
        "samples_per_s": steps_per_s * int(samples),
        "rays_per_s": steps_per_s * int(rays),
        "psnr_db": [float(x) for x in re.findall(r"psnr_avg=([\d.]+)", done.stdout)],
    }


def draw(psnr_db: dict[str, float], path: Path) -> None:
    figure, axes = plt.subplots(figsize=(6, 4))
    axes.plot([float(s) for s in psnr_db], list(psnr_db.values()), "o-", label="MULAN")
    axes.plot([GOAL_S], [GOAL_DB], "k+", label="goal")
    axes.set(xscale="log", xlabel="training time [s]", ylabel="PSNR of held-out views [dB]")
    axes.legend()
    figure.savefig(path, dpi=120, bbox_inches="tight")


def main(options: Options) -> int:
    gpu, name = find_gpu()
    if gpu is None:
        print(f"This benchmark needs a GPU and has none: {name}.", file=sys.stderr)
        return 2
    images = read_posed_images(options.data)
    options.out.mkdir(parents=True, exist_ok=True)

    def config(**limits: Any) -> TrainConfig:
        return TrainConfig(
            image_size=options.image_size,
            batch_samples=options.batch_samples,
            seed=options.seed,
            device=Device.GPU,
            evaluate_every_s=1e9,
            checkpoint_every_s=1e9,
            **limits,
        )

    with tempfile.TemporaryDirectory() as folder:
        train(images, config(steps=WARM_UP_STEPS), Path(folder))
    psnr_db, samples_per_s = {}, {}
    for budget_s in options.budgets_s:
        metrics = train(images, config(time_budget_s=budget_s), options.out / f"{budget_s:g}s")
        psnr_db[f"{budget_s:g}"] = metrics["psnr_db"]
        samples_per_s[f"{budget_s:g}"] = metrics["samples_per_s"]
        print(
            f"{budget_s:g} s: {metrics['psnr_db']:.2f} dB, {metrics['samples_per_s']:.3g} samples/s",
            flush=True,
        )
    longest_px = max(max(image.camera.width, image.camera.height) for image in images.train)
    result: dict[str, Any] = {
        "data": options.data.name,
        "gpu": name,
        "image_size": min(options.image_size, longest_px),
        "batch_samples": config().samples_a_batch(on_gpu=True),
        "psnr_db_at_s": psnr_db,
        "samples_per_s": samples_per_s,
        "samples_are": "field evaluations marched",
        "memory_gib": torch.cuda.max_memory_allocated() / 2**30,
        "provenance": {**provenance(options.seed), "cuda": torch.version.cuda},
    }
    if options.peer_python and options.nerfacc_examples:
        result["nerfacc_ngp"] = nerfacc(options.peer_python, options.nerfacc_examples, options.data)
    draw(psnr_db, options.out / "psnr.png")
    write_json(options.out / "metrics.json", result)
    return 0


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
