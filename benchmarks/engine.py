"""Quality against training time on posed photographs at their true poses: JSON and a picture.

python benchmarks/engine.py --data $MULAN_DATA/nerf_synthetic_lego --out runs/engine
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import tyro

from mulan.evaluation.provenance import provenance
from mulan.mission.image_sets import read_posed_images
from mulan.mission.run_folder import RunFolder, write_json
from mulan.reconstruction.reconstruct import reconstruct
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import NoWeights


@dataclass(frozen=True)
class Options:
    """Train once for every image size and time budget, score all held-out views."""

    data: Path
    """Posed image set."""
    out: Path
    """Folder for metrics.json, psnr.png and the runs."""
    image_sizes: tuple[int, ...] = (100, 200)
    """Longest image side in pixels."""
    budgets_s: tuple[float, ...] = (5.0, 20.0, 60.0)
    """Seconds of training; each is a run of its own with a schedule of that length."""
    seed: int = 0
    """Source of all randomness."""


def main(options: Options) -> None:
    images = read_posed_images(options.data)
    result: dict[str, Any] = {"data": options.data.name, "provenance": provenance(options.seed)}
    figure, axes = plt.subplots(figsize=(6, 4))
    for size in options.image_sizes:
        psnr_db, samples_per_s = {}, {}
        for budget_s in options.budgets_s:
            run = RunFolder(options.out / f"{size}px_{budget_s:g}s")
            config = TrainConfig(image_size=size, time_budget_s=budget_s, seed=options.seed)
            metrics = reconstruct(images, NoWeights(), config, run, lambda *_: None)
            psnr_db[f"{budget_s:g}"] = metrics["psnr_db"]
            samples_per_s[f"{budget_s:g}"] = metrics["samples_per_s"]
            print(f"{size} px, {budget_s:g} s: {metrics['psnr_db']:.2f} dB", flush=True)
        result[f"{size}px"] = {"psnr_db_at_s": psnr_db, "samples_per_s": samples_per_s}
        axes.plot([float(s) for s in psnr_db], list(psnr_db.values()), "o-", label=f"{size} px")
    axes.set(xscale="log", xlabel="training time [s]", ylabel="PSNR of held-out views [dB]")
    axes.legend()
    figure.savefig(options.out / "psnr.png", dpi=120, bbox_inches="tight")
    write_json(options.out / "metrics.json", result)


if __name__ == "__main__":
    main(tyro.cli(Options))
