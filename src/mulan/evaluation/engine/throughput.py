"""Training throughput of the native engine and of torch: same state, same batches, by turns."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, Protocol, runtime_checkable

import torch

from mulan.evaluation.engine.naive_torch import NaiveTorchField
from mulan.radiance.engine import RadianceEngine, RayBatch, StepReport
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.torch_engine import TorchEngine
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_field, choose_march
from mulan.reconstruction.field_file import FieldDescription
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.trainer import next_rays

NATIVE, TUNED, NAIVE = "native", "torch_tuned", "torch_naive"


@dataclass(frozen=True)
class ThroughputConfig:
    """How throughput is compared."""

    warm_up_steps: int = 300
    """Steps before measuring, so that the occupancy grid and the opacity are those of a scene half learnt."""
    steps: int = 24
    """Steps a contender takes before it is the next one's turn."""
    repeats: int = 9
    """Turns of each; the medians count."""
    batch_samples: int = 16384
    """Field evaluations a step."""
    seed: int = 0
    """Of field and batches."""


@runtime_checkable
class Trains(Protocol):
    """Anything that takes optimiser steps."""

    def train_step(self, batch: RayBatch, learning_rate_factor: float) -> StepReport:
        """One optimiser step."""
        ...


def describe_field(images: Sequence[CapturedImage], image_size: int, quick: bool = False) -> FieldDescription:
    """The field the trainer would choose for these photographs on the CPU (quick: a short training)."""
    space = choose_space(images)
    field = choose_field(image_size, len(images), space.unbounded)
    march = choose_march(image_size, space.unbounded, quick)
    return FieldDescription(field, march, space, not space.unbounded)


def new_torch_engine(
    description: FieldDescription, seed: int, optimiser: OptimiserConfig | None = None
) -> TorchEngine:
    """The tuned torch engine of a description, whatever this machine would choose."""
    d = description
    return TorchEngine(d.field, d.march, d.space, d.white_background, seed, optimiser)


def compare_throughput(
    images: Sequence[CapturedImage],
    image_size: int,
    config: ThroughputConfig,
    progress: Callable[[float, float, str], None],
) -> dict[str, Any]:
    """Let the engines train by turns on the same batches from the same half-learnt field.

    A sample is a field evaluation at a marched point, in occupied space, whether light reaches it or not.
    Drawing the batches is not counted; the refreshes of the occupancy grid are.

    Args:
        images: Cut-out objects (the naive field knows bounded scenes only).
        image_size: Their longest side; sets the sizes of the field.
        config: Steps and repeats.
        progress: Hears of the turns.

    Returns:
        ``samples_per_s`` and ``rays_per_s`` (medians of the turns; None for the native engine where its
        library could not be loaded), ``ratios`` (medians of the ratios within a turn, native over torch),
        ``ratio_range`` (least and greatest of a turn), ``sizes``.
    """
    description = describe_field(images, image_size)
    data = ImageTensors(images)
    library, _ = find_native_library()
    first: RadianceEngine = new_torch_engine(description, config.seed)
    if library is not None:
        # the parts of a description are the arguments of every engine
        first = NativeEngine(
            description.field, description.march, description.space, description.white_background, config.seed
        )
    rays = _warm_up(first, data, config)
    state = first.state()
    tuned, naive = new_torch_engine(description, config.seed), NaiveTorchField(description, config.seed)
    tuned.load_state(state)
    naive.load_state(state)
    contenders: dict[str, Trains] = {TUNED: tuned, NAIVE: naive}
    if library is not None:
        contenders = {NATIVE: first, **contenders}
    generator = torch.Generator().manual_seed(config.seed + 2)
    batches = [data.sample(rays, generator) for _ in range(config.steps)]
    turns: list[dict[str, tuple[float, float]]] = []
    for turn in range(config.repeats):
        progress(turn, config.repeats, "")
        turns.append({name: _samples_per_s(engine, batches) for name, engine in contenders.items()})
    samples = {name: median(turn[name][0] for turn in turns) for name in contenders}
    ratios = {
        f"{NATIVE}_over_{name}": [turn[NATIVE][0] / turn[name][0] for turn in turns]
        for name in (TUNED, NAIVE)
        if NATIVE in contenders
    }
    return {
        "samples_per_s": {NATIVE: None, **samples},
        "rays_per_s": {name: median(turn[name][1] for turn in turns) for name in contenders},
        "ratios": {name: median(values) for name, values in ratios.items()},
        "ratio_range": {name: [min(values), max(values)] for name, values in ratios.items()},
        "sizes": _sizes(description, rays, config),
    }


def _warm_up(engine: Trains, data: ImageTensors, config: ThroughputConfig) -> int:
    """Learn a little; returns how many rays make a batch of the wanted samples by then."""
    generator = torch.Generator().manual_seed(config.seed + 1)
    rays = 1024
    for _ in range(config.warm_up_steps):
        report = engine.train_step(data.sample(rays, generator), 1.0)
        rays = next_rays(rays, report.samples, config.batch_samples)
    return rays


def _samples_per_s(engine: Trains, batches: Sequence[RayBatch]) -> tuple[float, float]:
    began = time.perf_counter()
    samples = sum(engine.train_step(batch, 0.1).samples for batch in batches)
    seconds = time.perf_counter() - began
    return samples / seconds, sum(len(batch.origins) for batch in batches) / seconds


def _sizes(description: FieldDescription, rays: int, config: ThroughputConfig) -> Mapping[str, Any]:
    return {
        "field": asdict(description.field),
        "march": asdict(description.march),
        "rays_a_batch": rays,
        "threads": torch.get_num_threads(),
        **asdict(config),
    }
