"""Learning a field from posed photographs: batches, schedule, checkpoints, training curve."""

import math
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.radiance.engine import RadianceEngine
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.checkpoint import Progress, read_checkpoint, write_checkpoint
from mulan.reconstruction.data_parallel import DataParallel
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_field, choose_march, choose_optimiser
from mulan.reconstruction.field_file import FieldDescription, save_field
from mulan.reconstruction.held_out import psnr_db
from mulan.reconstruction.photographs import load_photographs
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.process_group import ProcessGroup
from mulan.reconstruction.robot_exposure import RobotExposure
from mulan.reconstruction.scene_space import choose_space
from mulan.reconstruction.sub_pixels import Antialiasing
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import Weighting

MAX_RAYS = 16384  # of one process, with the CPU's batch
CURVE_POINTS = 5  # at least, of a training with a time budget
CURVE_VIEWS = 4  # test views behind each point of the training curve
SMOOTHING = 0.95  # of the running mean squared error shown in the curve


@dataclass(frozen=True)
class TrainingStatus:
    """What a progress display needs after each step.

    Attributes:
        fraction_done: Share of the training behind us.
        steps, seconds: Optimiser steps and seconds of learning.
        samples: Field evaluations so far.
        train_psnr_db: Of recent batches.
        engine: The field as it stands; to look at, off the training clock.
        sub_pixels: Rays a side of a pixel that its pictures are made of by now.
    """

    fraction_done: float
    steps: int
    seconds: float
    samples: int
    train_psnr_db: float
    engine: RadianceEngine
    sub_pixels: int = 1


@runtime_checkable
class BetweenSteps(Protocol):
    """Something that acts between the steps of a training, on the training's clock."""

    def begin(self, data: PosedPixels) -> None:
        """Called once before the first step, and after a checkpoint was read."""
        ...

    def after_step(self, engine: RadianceEngine, data: PosedPixels, steps: int, fraction_done: float) -> None:
        """Called after each step."""
        ...

    def state(self) -> dict[str, Tensor]:
        """What a checkpoint must keep."""
        ...

    def load_state(self, saved: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` gave and take it out of a checkpoint's tensors."""
        ...


@dataclass(frozen=True)
class TrainingResult:
    """A learnt field.

    Attributes:
        engine: The field.
        description: Its sizes and space.
        test: Held-out photographs at the size trained at, for :func:`evaluate_held_out`.
        history: Training curve, as in ``history.json``.
        steps, seconds, samples: Optimiser steps, seconds of learning, field evaluations.
        exposure: How the robots' cameras differ, if that was learnt.
    """

    engine: RadianceEngine
    description: FieldDescription
    test: tuple[CapturedImage, ...]
    history: tuple[dict[str, Any], ...]
    steps: int
    seconds: float
    samples: int
    exposure: RobotExposure | None = None


def train(
    images: PosedImageSet,
    weighting: Weighting,
    config: TrainConfig,
    run: RunFolder,
    progress: Callable[[TrainingStatus], None] | None = None,
    group: ProcessGroup | None = None,
    between_steps: BetweenSteps | None = None,
    exposure: RobotExposure | None = None,
) -> TrainingResult:
    """Learn a field and write it to the run, resuming an unfinished training of the same options and images.

    Writes ``checkpoint.safetensors`` as it goes (removed at the end), then ``field.safetensors`` and
    ``history.json``.

    Args:
        images: Photographs with poses.
        weighting: How far each pixel is trusted.
        config: Options.
        run: Folder to write to.
        progress: Called after every step.
        group: The processes that train together; each calls this with the same arguments, one writes.
        between_steps: Acts between the steps, as pose refinement does; not with several processes.
        exposure: Gains of the robots' cameras to go on from, where they are learnt.

    Raises:
        InputError: There is no photograph, one is damaged, no pixel has weight, an option makes no sense, or
            an unfinished training in the run was started with other options or images.
    """
    if config.robot_exposure:
        exposure = exposure or RobotExposure(images.train, config.seed)
    acting = tuple(one for one in (exposure, between_steps) if one is not None)
    with group.all_or_none() if group else nullcontext():
        loop, description = _prepare(images, weighting, config, run, group, acting)
    loop.start()
    loop.run_to_end(progress)
    state = loop.state
    with group.all_or_none() if group else nullcontext():
        if group is None or group.leads:
            save_field(run.field, loop.engine, description)
            write_json(run.history, list(state.history))
            run.checkpoint.unlink(missing_ok=True)
    return TrainingResult(
        loop.engine,
        description,
        loop.test,
        state.history,
        state.steps,
        state.seconds,
        state.samples,
        exposure,
    )


def _prepare(
    images: PosedImageSet,
    weighting: Weighting,
    config: TrainConfig,
    run: RunFolder,
    group: ProcessGroup | None,
    acting: tuple[BetweenSteps, ...],
) -> tuple["_Loop", FieldDescription]:
    """The photographs in memory and an untrained field."""
    _check(images, config, group)
    photographs = load_photographs(images, config, run.root / "decoded", group)
    captured, test = photographs.train, photographs.test
    space = choose_space(captured)
    ignored = weighting.ignored(captured, space)
    if any(ignored):
        # nor must their poses, which are trusted least, say where the scene is
        space = choose_space([image for image, out in zip(captured, ignored, strict=True) if not out])
    device = config.device.resolve()
    on_gpu = device.type == "cuda"
    field = config.field or choose_field(config.image_size, len(captured), space.unbounded, on_gpu)
    march = config.march or choose_march(config.image_size, space.unbounded, config.quick, on_gpu)
    antialiasing = Antialiasing.choose(config.antialias_share, space.unbounded, on_gpu)
    description = FieldDescription(field, march, space, not space.unbounded, antialiasing.sub_pixels)
    data = photographs.with_weights(weighting, space)
    if not data.drawable_pixels:
        raise InputError(images.source, "weights", "are zero everywhere", "use weights that keep some images")
    optimiser = choose_optimiser(space.unbounded, config.quick and not on_gpu)
    engine = description.new_engine(config.seed, optimiser, device)
    data.move_to(device)
    identity = _identity(config, weighting, description, optimiser, data)
    identity["processes"] = group.place.processes if group else 1
    loop = _Loop(config, space.unbounded, antialiasing, engine, data, test, run, identity, group, acting)
    return loop, description


class _Loop:
    """The steps of one training, taken up wherever its checkpoint left off."""

    def __init__(
        self,
        config: TrainConfig,
        unbounded: bool,
        antialiasing: Antialiasing,
        engine: RadianceEngine,
        data: PosedPixels,
        test: tuple[CapturedImage, ...],
        run: RunFolder,
        identity: dict[str, Any],
        group: ProcessGroup | None,
        acting: tuple[BetweenSteps, ...],
    ) -> None:
        self._acting = acting
        self._config, self._data, self._run = config, data, run
        self.engine, self.test = engine, test
        self._group, self._together = group, None
        self._processes = group.place.processes if group else 1
        self._writes = group is None or group.leads
        self._identity, self._antialiasing = identity, antialiasing
        self._unbounded, self._on_gpu = unbounded, engine.device.type == "cuda"
        self._curve_views = ImageTensors(test[:: max(1, len(test) // CURVE_VIEWS)]) if test else None
        self._sampler = torch.Generator().manual_seed(config.seed + 1)
        self.state = Progress()
        if self._writes and run.checkpoint.exists():
            tensors, self._sampler, self.state = read_checkpoint(run.checkpoint, identity)
            try:
                for one in acting:
                    one.load_state(tensors)
                engine.load_state(tensors)
            except ValueError as error:
                raise InputError(run.checkpoint, "field", str(error), "delete it to start anew") from error
        self._saved_s = self._evaluated_s = 0.0

    def start(self) -> None:
        """Agree with the other processes on where to begin."""
        if self._group:
            self._together = DataParallel(self._group, self.engine)
            self.state = self._together.share(self._sampler, self.state)
        for one in self._acting:
            one.begin(self._data)
        # a resumed training owes its next checkpoint and curve point from where it stands
        self._saved_s = self._evaluated_s = self.state.seconds

    def run_to_end(self, progress: Callable[[TrainingStatus], None] | None) -> None:
        with self._together.stopping_together() if self._together else nullcontext():
            self._run_to_end(progress)

    def _run_to_end(self, progress: Callable[[TrainingStatus], None] | None) -> None:
        try:
            while self._config.fraction_done(self.state.steps, self.state.seconds) < 1:
                self._advance()
                if progress:
                    progress(self._status())
        except KeyboardInterrupt:
            self._save()
            raise
        if not self.state.history or self.state.history[-1]["steps"] < self.state.steps:
            self._add_to_history()

    def _advance(self) -> None:
        config = self._config
        self._step(config.learning_rate_factor(config.fraction_done(self.state.steps, self.state.seconds)))
        seconds = self.state.seconds
        if seconds - self._evaluated_s >= min(config.evaluate_every_s, config.time_budget_s / CURVE_POINTS):
            self._add_to_history()
        if seconds - self._saved_s >= config.checkpoint_every_s:
            self._save()
        if self._together and self._together.stop_agreed:
            raise KeyboardInterrupt

    def _save(self) -> None:
        self._saved_s = self.state.seconds
        if self._together:
            self.state = self._together.share(self._sampler, self.state)
        if not self._writes:
            return
        tensors = self.engine.state()
        for one in self._acting:
            tensors |= one.state()
        write_checkpoint(self._run.checkpoint, tensors, self._sampler, self.state, self._identity)

    def _step(self, learning_rate_factor: float) -> None:
        s = self.state
        began = time.perf_counter()
        pairs = self._pixels_are_pairs
        if self._together:
            report, took = self._together.step(self._data, s.rays, pairs, self._sampler, learning_rate_factor)
        else:
            draw = self._data.sample_pairs if pairs else self._data.sample
            report = self.engine.train_step(draw(s.rays, self._sampler), learning_rate_factor)
            done = self._config.fraction_done(s.steps, s.seconds)
            for one in self._acting:
                one.after_step(self.engine, self._data, s.steps + 1, done)
            took = time.perf_counter() - began
        seconds = s.seconds + took
        error = report.mean_squared_error
        if s.mean_squared_error is not None:
            error = SMOOTHING * s.mean_squared_error + (1 - SMOOTHING) * error
        config = self._config
        done = config.fraction_done(s.steps, s.seconds)
        target = config.batch_samples_at(done, self._unbounded, self._on_gpu)
        rays = next_rays(s.rays, report.samples, target, self._processes)
        samples = s.samples + report.samples
        self.state = Progress(s.steps + 1, seconds, rays, samples, report.loss, error, s.history)

    @property
    def _pixels_are_pairs(self) -> bool:
        return self._antialiasing.began(self._config.fraction_done(self.state.steps, self.state.seconds))

    @property
    def _sub_pixels(self) -> int:
        return self._antialiasing.sub_pixels if self._pixels_are_pairs else 1

    def _status(self) -> TrainingStatus:
        s = self.state
        done = self._config.fraction_done(s.steps, s.seconds)
        return TrainingStatus(
            done,
            s.steps,
            s.seconds,
            s.samples,
            _decibel(s.mean_squared_error),
            self.engine,
            self._sub_pixels,
        )

    def _add_to_history(self) -> None:
        views, s = self._curve_views, self.state
        test = []
        if views and self._writes:
            test = [psnr_db(self.engine, views, i, self._sub_pixels) for i in range(len(views))]
        point = {
            "seconds": round(s.seconds, 3),
            "steps": s.steps,
            "loss": s.loss,
            "train_psnr_db": _decibel(s.mean_squared_error),
            "test_psnr_db": sum(test) / len(test) if test else None,
        }
        self.state = replace(s, history=(*s.history, point))
        self._evaluated_s = s.seconds


def _check(images: PosedImageSet, config: TrainConfig, group: ProcessGroup | None) -> None:
    if not images.train:
        raise InputError(images.source, "photographs", "there is none to learn from", "give at least one")
    for option, value in (
        ("--time-budget", config.time_budget_s),
        ("--image-size", config.image_size),
        ("--batch-samples", 1 if config.batch_samples is None else config.batch_samples),
        ("--first-batch-samples", 1 if config.first_batch_samples is None else config.first_batch_samples),
        ("--image-memory-share", config.image_memory_share),
        ("--steps", 1 if config.steps is None else config.steps),
    ):
        if not (math.isfinite(value) and value > 0):
            raise InputError(option, "value", f"{value} is not a positive number", "give one above zero")
    if config.antialias_share and config.device.resolve().type == "cuda":
        problem = "needs the CPU engines; the GPU engine learns one ray a pixel"
        raise InputError("--antialias-share", "value", problem, "give 0, or --device cpu")
    if config.antialias_share is not None and not 0 <= config.antialias_share <= 1:
        problem = f"{config.antialias_share} is no share"
        raise InputError("--antialias-share", "value", problem, "give one between 0 and 1")
    if config.robot_exposure and group:
        problem = "cannot be learnt by several processes"
        raise InputError("--robot-exposure", "torchrun", problem, "train in one process, or leave it out")


def _identity(
    config: TrainConfig,
    weighting: Weighting,
    description: FieldDescription,
    optimiser: OptimiserConfig,
    data: PosedPixels,
) -> dict[str, Any]:
    """What must be the same for a training to be resumed; how often it reports may change."""
    options = config.what_is_learnt()
    for name in ("device", "field", "march"):
        del options[name]
    return {
        **options,
        "weighting": f"{weighting}",
        "description": description.to_json(),
        "optimiser": f"{optimiser}",
        "images": data.fingerprint(),
    }


def next_rays(rays: int, samples: int, target: int, processes: int = 1) -> int:
    """Rays of all processes that would have met each one's target, at most doubled or halved at a time."""
    wanted = int(rays * target * processes / max(samples, 1))
    return max(32, min(max(wanted, rays // 2), rays * 2, max(MAX_RAYS, target // 2) * processes))


def _decibel(mean_squared_error: float | None) -> float:
    return 0.0 if mean_squared_error is None else -10 * math.log10(max(mean_squared_error, 1e-10))
