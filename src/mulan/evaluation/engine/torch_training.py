"""The torch fields trained by our recipe, scored on the same clock: what fused kernels are worth."""

import time
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import torch

from mulan.evaluation.engine.curve import THRESHOLD_DB, seconds_to_psnr
from mulan.evaluation.engine.naive_torch import NaiveTorchField
from mulan.evaluation.engine.scenes import EngineScene
from mulan.evaluation.engine.scoring import CurveRecorder
from mulan.evaluation.engine.throughput import (
    NAIVE,
    TUNED,
    Trains,
    describe_field,
    new_torch_engine,
)
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_optimiser
from mulan.reconstruction.held_out import Renders
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import next_rays


@runtime_checkable
class TrainableField(Trains, Renders, Protocol):
    """Takes optimiser steps and renders."""


def torch_fields(scene: EngineScene, config: TrainConfig) -> dict[str, TrainableField]:
    """The tuned and the naive torch field as the trainer would set them up for a scene and a training."""
    images = load_captured(scene.images().train, scene.image_size)
    description = describe_field(images, scene.image_size, config.quick)
    optimiser = choose_optimiser(description.space.unbounded, config.quick)
    return {
        TUNED: new_torch_engine(description, config.seed, optimiser),
        NAIVE: NaiveTorchField(description, config.seed, optimiser),
    }


def train_torch_field(
    field: TrainableField,
    scene: EngineScene,
    config: TrainConfig,
    curve_points: int,
    progress: Callable[[float, float, str], None],
) -> dict[str, Any]:
    """One training within a time budget; the clock runs while batches are drawn and steps taken.

    Returns:
        ``psnr_curve``, ``samples_per_s``, ``seconds_to_28_db``, as the peers report them.
    """
    images = scene.images()
    data = ImageTensors(load_captured(images.train, scene.image_size))
    views = ImageTensors(load_captured(images.test, scene.image_size))
    recorder = CurveRecorder(views, config.time_budget_s, curve_points)
    generator = torch.Generator().manual_seed(config.seed + 1)
    rays, seconds, samples, steps = 256, 0.0, 0, 0
    while (done := config.fraction_done(steps, seconds)) < 1:
        recorder.visit(field, seconds)
        progress(done, 1, recorder.latest)
        began = time.perf_counter()
        report = field.train_step(data.sample(rays, generator), config.learning_rate_factor(done))
        seconds += time.perf_counter() - began
        samples, steps = samples + report.samples, steps + 1
        rays = next_rays(rays, report.samples, config.batch_samples_at(done, unbounded=False, on_gpu=False))
    recorder.finish(field, seconds)
    return {
        "psnr_curve": recorder.curve,
        "samples_per_s": samples / seconds,
        "seconds_to_28_db": seconds_to_psnr(recorder.curve, THRESHOLD_DB),
    }
