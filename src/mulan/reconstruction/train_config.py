"""Options of a training."""

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import EnumChoicesFromValues, arg

from mulan.radiance.backend import Device
from mulan.radiance.config import FieldConfig, MarchConfig

# of a quick training of pictures of 100 pixels a side; they grow with the number of a picture's pixels
FIRST_OBJECT_BATCH = 4096  # samples
QUICK_S, QUICK_STEPS = 20.0, 2500


@dataclass(frozen=True)
class TrainConfig:
    """How long, how large and how a field is learnt."""

    image_size: int = 200
    """Longest side the photographs are brought down to, in pixels."""
    time_budget_s: Annotated[float, arg(name="time-budget", aliases=["--time-budget-s"])] = 120.0
    """Seconds of learning (evaluation and files excluded), unless a number of steps is given."""
    steps: int | None = None
    """Optimiser steps; overrides the time budget and makes the result repeatable bit for bit."""
    batch_samples: int | None = None
    """Field evaluations a step of each process at the end of the training; the number of rays adapts to it.
    If not given 16384, on a GPU 1048576."""
    first_batch_samples: int | None = None
    """Field evaluations of the first step, from which they grow by equal factors in equal shares of the
    training; chosen by the kind of scene and the length of the training if not given."""
    final_learning_rate: float = 0.01
    """Learning rate at the end, as a fraction of the first (half a cosine between)."""
    antialias_share: float | None = None
    """Last share of the training in which a pixel is two rays judged by their mean; the field's pictures then
    have four rays a pixel. 0 = rays through the pixels' centres only, which render four times as fast; chosen
    by the kind of scene if not given."""
    robot_exposure: bool = False
    """Learn how much brighter each robot's camera shows red, green and blue than the first robot's, in whose
    colours the field's pictures then are."""
    seed: int = 0
    """Of the initial field, the batches and the sampling."""
    evaluate_every_s: float = 15.0
    """Seconds of learning between points of the training curve."""
    checkpoint_every_s: float = 10.0
    """Seconds of learning between checkpoints."""
    image_memory_share: float = 0.5
    """Share of the free memory decoded photographs may take; larger sets are decoded into files instead."""
    image_cache: Path | None = None
    """Folder for those files; 'decoded' in the run folder if not given."""
    device: EnumChoicesFromValues[Device] = Device.AUTO
    """Where to compute; auto takes the GPU if there is one. Training goes on elsewhere if sizes are given."""
    field: FieldConfig | None = None
    """Sizes of the field; chosen from device, image size and number of views if not given."""
    march: MarchConfig | None = None
    """How rays are sampled; chosen from device and image size if not given."""

    def samples_a_batch(self, on_gpu: bool) -> int:
        """Field evaluations to aim at in the last step."""
        # of an H200's step most is Python starting kernels, whatever their size
        return self.batch_samples or (2**20 if on_gpu else 2**14)

    @property
    def quick(self) -> bool:
        """Whether the rough shape matters more than the last detail: little time for each pixel of a picture.

        Bounds from ``benchmarks/bounded.py``.
        """
        if self.steps is None:
            return self.time_budget_s <= QUICK_S * self._pixels
        return self.steps <= QUICK_STEPS * self._pixels

    @property
    def _pixels(self) -> float:
        """Of a picture, in those of one of 100 pixels a side; 1 to 4, since larger ones were not compared."""
        return min(max(self.image_size / 100, 1.0) ** 2, 4.0)

    def what_is_learnt(self) -> dict[str, Any]:
        """The options the result depends on, not those on reports and files."""
        options = asdict(self)
        for name in ("evaluate_every_s", "checkpoint_every_s", "image_memory_share", "image_cache"):
            del options[name]
        return options

    def fraction_done(self, steps: int, seconds: float) -> float:
        """Share of the training behind us, 1 when it is over."""
        done = steps / self.steps if self.steps is not None else seconds / self.time_budget_s
        return min(done, 1.0)

    def learning_rate_factor(self, fraction_done: float) -> float:
        """Half a cosine from 1 to the final learning rate."""
        cosine = 0.5 * (1 + math.cos(math.pi * fraction_done))
        return self.final_learning_rate + (1 - self.final_learning_rate) * cosine

    def batch_samples_at(self, fraction_done: float, unbounded: bool, on_gpu: bool) -> int:
        """Field evaluations to aim at in the next step.

        Small batches learn the rough shape of an object in little time and large ones its details, with less
        noise (Smith et al. 2018, "Don't decay the learning rate, increase the batch size").
        """
        last, first = self.samples_a_batch(on_gpu), self.first_batch_samples
        if first is None:
            grows = self.quick and not (unbounded or on_gpu)
            first = min(round(FIRST_OBJECT_BATCH * self._pixels), last) if grows else last
        return round(first * (last / first) ** fraction_done)
