"""Quality and speed of the native engine on NeRF-synthetic lego; not a test.

python benchmarks/lego_engine.py --side 100 --seconds 60
"""

import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import tyro
from PIL import Image
from torch import Tensor

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_grid import NativeGridConfig
from mulan.radiance.native_engine import NativeConfig, NativeEngine
from mulan.radiance.space import SceneSpace
from mulan.radiance.torch_engine import OptimiserConfig

DATA = Path(os.environ.get("MULAN_DATA", Path(__file__).parents[2] / "shared" / "data"))


@dataclass(frozen=True)
class Views:
    """Pixels [n, h, w, 3] over white and the rays through their centres."""

    pixels: Tensor
    T_world_camera: Tensor
    camera_directions: Tensor
    focal: float

    def rays(self, view: int) -> tuple[Tensor, Tensor]:
        """Origins and directions of all pixels of a view."""
        T = self.T_world_camera[view]
        d = self.camera_directions @ T[:3, :3].T
        return T[:3, 3].expand_as(d).contiguous(), d


def load_views(split: str, side: int) -> Views:
    folder = DATA / "nerf_synthetic_lego"
    meta = json.loads((folder / f"transforms_{split}.json").read_text())
    images, poses = [], []
    for frame in meta["frames"]:
        path = folder / (frame["file_path"].removeprefix("./") + ".png")
        if not path.exists():
            continue
        rgba = np.asarray(Image.open(path), dtype=np.float32) / 255
        rgb = rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]
        block = rgb.shape[0] // side
        images.append(rgb.reshape(side, block, side, block, 3).mean((1, 3)))
        poses.append(frame["transform_matrix"])
    focal = 0.5 * side / math.tan(0.5 * meta["camera_angle_x"])
    v, u = torch.meshgrid(torch.arange(side) + 0.5, torch.arange(side) + 0.5, indexing="ij")
    d = torch.stack([(u - side / 2) / focal, -(v - side / 2) / focal, -torch.ones_like(u)], -1).view(-1, 3)
    d = d / d.norm(dim=-1, keepdim=True)
    return Views(torch.tensor(np.stack(images)), torch.tensor(poses, dtype=torch.float32), d, focal)


@dataclass
class Options:
    side: int = 100
    seconds: float = 60.0
    report_at: tuple[float, ...] = (5, 20, 60, 180)
    log2_table: int = 15
    levels: int = 8
    finest: float = 2.5
    """Finest level over image side."""
    base: int = 16
    width: int = 32
    steps: int = 256
    samples: int = 16384
    """Marched samples a batch."""
    radius: float = 1.3
    table_rate: float = 2e-2
    network_rate: float = 1e-2
    final_rate: float = 0.02
    """Learning-rate factor at the end of the cosine."""
    huber: float | None = None
    update_untouched: bool = False
    warm_up: int = 6
    occupancy_every: int = 16
    degree: int = 3
    seed: int = 0
    threads: int = 0
    shared_machine: bool = False
    """For a busy machine: one thread; count its CPU time, that of the step halved as if on two cores."""


def test_psnr(engine: NativeEngine, views: Views) -> float:
    total = 0.0
    for i in range(len(views.pixels)):
        colour = engine.render(*views.rays(i)).colour
        error = (colour - views.pixels[i].view(-1, 3)).square().mean()
        total += -10 * math.log10(error)
    return total / len(views.pixels)


def main(o: Options) -> None:
    if o.shared_machine:
        o.threads = 1
        torch.set_num_threads(1)
    train, test = load_views("train", o.side), load_views("test", o.side)
    engine = NativeEngine(
        FieldConfig(
            levels=o.levels,
            log2_table_size=o.log2_table,
            base_resolution=o.base,
            finest_resolution=int(o.finest * o.side),
            width=o.width,
            harmonics_degree=o.degree,
        ),
        MarchConfig(steps=o.steps),
        SceneSpace((0.0, 0.0, 0.0), o.radius, False),
        white_background=True,
        seed=o.seed,
        optimiser=OptimiserConfig(
            table_learning_rate=o.table_rate,
            network_learning_rate=o.network_rate,
            huber_delta=o.huber,
            occupancy_every=o.occupancy_every,
        ),
        native=NativeConfig(
            threads=o.threads,
            update_untouched=o.update_untouched,
            occupancy=NativeGridConfig(warm_up_refreshes=o.warm_up),
        ),
    )
    clock = time.process_time if o.shared_machine else time.perf_counter
    share = 0.5 if o.shared_machine else 1.0
    g = torch.Generator().manual_seed(o.seed)
    pixels, per_view, centres = train.pixels.view(-1, 3), o.side**2, train.T_world_camera[:, :3, 3]
    directions = torch.cat([train.rays(view)[1] for view in range(len(train.pixels))])
    rays, used, step, marched, in_step = o.samples // 100, 0.0, 0, 0, 0.0
    reports = [s for s in o.report_at if s < o.seconds] + [o.seconds]
    while reports:
        start = clock()
        factor = o.final_rate + (1 - o.final_rate) * 0.5 * (1 + math.cos(math.pi * min(used / o.seconds, 1)))
        index = torch.randint(len(pixels), (rays,), generator=g)
        view = index // per_view
        batch = RayBatch(
            centres.index_select(0, view),
            directions.index_select(0, index),
            pixels.index_select(0, index),
            torch.ones(rays),
            view,
        )
        before = clock()
        report = engine.train_step(batch, factor)
        step_seconds = (clock() - before) * share
        in_step += step_seconds
        step += 1
        marched += report.samples
        rays = int(min(max(rays * min(max(o.samples / max(report.samples, 1), 0.5), 2.0), 64), 65536))
        used += before - start + step_seconds
        if used >= reports[0]:
            reports.pop(0)
            print(
                f"{used:6.1f} s  {test_psnr(engine, test):6.3f} dB  {step} steps  {rays} rays/step"
                f"  {marched / used / 1e6:.2f} M samples/s ({marched / in_step / 1e6:.2f} in the step)"
                f"  {used / step * 1e3:.2f} ms/step",
                flush=True,
            )
    origins, directions = (torch.cat(x) for x in zip(*(test.rays(i) for i in range(10)), strict=True))
    best = share * min(_seconds(lambda: engine.render(origins, directions), clock) for _ in range(5))
    print(f"rendering {len(origins) / best / 1e6:.2f} M rays/s; {torch.get_num_threads()} threads")


def _seconds(call: Callable[[], object], clock: Callable[[], float]) -> float:
    start = clock()
    call()
    return clock() - start


if __name__ == "__main__":
    main(tyro.cli(Options))
