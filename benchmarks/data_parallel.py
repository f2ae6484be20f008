"""What a second process brings: throughput of one against two, each on its own core, and their loss curves.

python benchmarks/data_parallel.py --data $MULAN_DATA/nerf_synthetic_lego --out runs/data_parallel

Writes metrics.json and data_parallel.png. Needs two idle cores: wall-clock ratios mean nothing beside other
work; the ratio by CPU time, which leaves out all waiting, is written too.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import tyro

from mulan.evaluation.provenance import provenance
from mulan.mission.image_sets import read_posed_images
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.reconstruction.process_group import processes_of_torchrun
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingStatus, train
from mulan.reconstruction.weights import NoWeights

CURVE_STEPS = 96  # before the occupancy grid first drops cells; until then both curves draw the same rays


@dataclass(frozen=True)
class Options:
    """Train in one process and in two, in turns."""

    data: Path
    """Posed image set."""
    out: Path
    """Folder for metrics.json and data_parallel.png."""
    image_sizes: tuple[int, ...] = (100, 200)
    """Longest image side in pixels; the field's size goes by it."""
    batch_samples: int = 16384
    """Field evaluations a step of each process."""
    warm_up_steps: int = 200
    """Steps before the measurement."""
    steps: int = 400
    """Steps measured."""
    repeats: int = 5
    """Pairs of runs at each size."""
    seed: int = 0
    """Source of all randomness."""
    worker: bool = False
    """Used by the program itself: be one of the processes."""


def be_worker(options: Options) -> None:
    """Train on a core of one's own; print what it took."""
    rank = int(os.environ.get("LOCAL_RANK", 0))
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[rank % len(cores)]})
    images = read_posed_images(options.data)
    seen: list[tuple[float, float, int]] = []

    def progress(status: TrainingStatus) -> None:
        seen.append((time.perf_counter(), time.process_time(), status.samples))

    config = TrainConfig(
        image_size=options.image_sizes[0],
        steps=options.warm_up_steps + options.steps,
        batch_samples=options.batch_samples,
        first_batch_samples=options.batch_samples,
        evaluate_every_s=0.0,
        checkpoint_every_s=1e9,
        seed=options.seed,
    )
    with processes_of_torchrun() as group, tempfile.TemporaryDirectory() as folder:
        only_train = PosedImageSet(images.train, (), images.source)
        result = train(only_train, NoWeights(), config, RunFolder(Path(folder)), progress, group)
    (wall_0, cpu_0, samples_0), (wall_1, cpu_1, samples_1) = seen[options.warm_up_steps], seen[-1]
    measured = {
        "rank": rank,
        "wall_s": wall_1 - wall_0,
        "cpu_s": cpu_1 - cpu_0,
        "samples": samples_1 - samples_0,
        "loss": [point["loss"] for point in result.history],
    }
    # one write, lest two processes' lines mix
    sys.stdout.write(json.dumps(measured) + "\n")
    sys.stdout.flush()


def run(options: Options, size: int, processes: int, batch_samples: int) -> list[dict[str, Any]]:
    """Results of all processes of one training, by rank."""
    torchrun = [
        *("-m", "torch.distributed.run", "--standalone"),
        *("--nproc-per-node", str(processes)),
    ]
    arguments = {
        "data": options.data,
        "out": options.out,
        "image-sizes": size,
        "batch-samples": batch_samples,
        "warm-up-steps": options.warm_up_steps,
        "steps": options.steps,
        "seed": options.seed,
    }
    command = [sys.executable, *(torchrun if processes > 1 else []), __file__, "--worker"]
    for name, value in arguments.items():
        command += [f"--{name}", str(value)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    results = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    return sorted(results, key=lambda result: result["rank"])


def compare(options: Options, size: int) -> dict[str, Any]:
    """Ratios of throughput over the repeats, and the loss curves of the same joint batch."""
    by_wall, by_cpu, rates = [], [], {"one_process": [], "two_processes": []}
    two: list[dict[str, Any]] = []
    for _ in range(options.repeats):
        [one] = run(options, size, 1, options.batch_samples)
        two = run(options, size, 2, options.batch_samples)
        rate = [r[0]["samples"] / max(p["wall_s"] for p in r) for r in ([one], two)]
        by_wall.append(rate[1] / rate[0])
        cpu = [r[0]["samples"] / max(p["cpu_s"] for p in r) for r in ([one], two)]
        by_cpu.append(cpu[1] / cpu[0])
        rates["one_process"].append(rate[0])
        rates["two_processes"].append(rate[1])
        print(f"{size} px: two processes {by_wall[-1]:.2f}x by wall, {by_cpu[-1]:.2f}x by CPU", flush=True)
    [double] = run(options, size, 1, 2 * options.batch_samples)
    pairs = list(zip(two[0]["loss"], double["loss"], strict=True))
    differences = [abs(a / b - 1) for a, b in pairs]
    later = pairs[CURVE_STEPS:]
    return {
        "samples_per_s": {name: statistics.median(values) for name, values in rates.items()},
        "ratio_wall": {"median": statistics.median(by_wall), "all": by_wall},
        "ratio_cpu": {"median": statistics.median(by_cpu), "all": by_cpu},
        "loss_difference": {
            "largest_of_first_8_steps": max(differences[:8]),
            "largest_of_first_32_steps": max(differences[:32]),
            f"largest_of_first_{CURVE_STEPS}_steps": max(differences[:CURVE_STEPS]),
            "mean_of_later_steps": abs(sum(a for a, _ in later) / sum(b for _, b in later) - 1),
        },
        "loss": {"two_processes": two[0]["loss"], "one_process_double_batch": double["loss"]},
    }


def main(options: Options) -> None:
    if len(os.sched_getaffinity(0)) < 2:
        raise SystemExit("two processes need two cores")
    result: dict[str, Any] = {"data": options.data.name, "provenance": provenance(options.seed)}
    figure, axes = plt.subplots(1, 2, figsize=(10, 4))
    for size in options.image_sizes:
        result[f"{size}px"] = found = compare(options, size)
        label = f"{size} px: median {found['ratio_wall']['median']:.2f}"
        axes[0].plot(range(1, options.repeats + 1), found["ratio_wall"]["all"], "o", label=label)
        for name, style in (("one_process_double_batch", "-"), ("two_processes", "--")):
            axes[1].semilogy(found["loss"][name], style, label=f"{size} px, {name.replace('_', ' ')}")
    axes[0].axhline(1.6, color="grey", linewidth=0.8)
    axes[0].set(xlabel="repeat", ylabel="throughput of two processes over one", ylim=(0, 2.1))
    axes[1].set(xlabel="step", ylabel="loss")
    for axis in axes:
        axis.legend(fontsize=7)
    where = result["provenance"]
    figure.suptitle(
        f"{options.data.name}, seed {options.seed}, {where['date']}, {where['machine']}", fontsize=8
    )
    options.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out / "data_parallel.png", dpi=120, bbox_inches="tight")
    write_json(options.out / "metrics.json", result)


if __name__ == "__main__":
    given = tyro.cli(Options)
    (be_worker if given.worker else main)(given)
