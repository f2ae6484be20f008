"""Coarse to fine: poses and a smooth field by turns, from localization's estimates to a pixel or less."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Int
from numpy.typing import NDArray

from mulan.radiance.backend import new_engine
from mulan.radiance.engine import RadianceEngine
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.field_choice import choose_field, choose_march, choose_optimiser
from mulan.reconstruction.refinement.anchored import anchored_images, anchored_space
from mulan.reconstruction.refinement.blurred_images import blurred
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels
from mulan.reconstruction.refinement.field_frame import FieldFrame
from mulan.reconstruction.refinement.gauss_newton import PoseState, gauss_newton_step
from mulan.reconstruction.refinement.multi_start import restart, spread_starts
from mulan.reconstruction.refinement.photometric import residual_sigma, residuals
from mulan.reconstruction.refinement.refinement_config import CoarseStage, RefinementConfig
from mulan.reconstruction.refinement.standing_estimates import let_estimates_stand
from mulan.reconstruction.robot_exposure import RobotExposure
from mulan.reconstruction.trainer import next_rays

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


@dataclass
class _Clock:
    """Steps done, for the progress display."""

    progress: Progress
    total: int
    done: int = 0

    def tick(self, words: str) -> None:
        self.done += 1
        self.progress(self.done, self.total, words)


def register(
    images: Sequence[CapturedImage],
    state: PoseState,
    config: RefinementConfig,
    seed: int,
    progress: Progress,
    exposure: RobotExposure | None = None,
) -> Bool[NDArray, "k"]:
    """Move the uncertain images of a set to where a common field explains all photographs.

    Args:
        images: Photographs at the registration's size, exact and uncertain ones.
        state: The uncertain images' poses, changed in place.
        config: Stages.
        seed: Of field, batches and starts.
        progress: Called after every step of the field.
        exposure: Gains of the robots' cameras, fitted along with the poses; None = cameras are equal.

    Returns:
        Which of the uncertain images fit nowhere near where localization has them.
    """
    anchored = anchored_images(images)
    space = anchored_space(images)
    field = choose_field(config.image_size, len(images), space.unbounded)
    march = choose_march(config.image_size, space.unbounded, quick=True)
    optimiser = choose_optimiser(space.unbounded, quick=True)
    torch_random, random = torch.Generator().manual_seed(seed + 2), np.random.default_rng(seed + 3)
    frame_is_free = len(state.image) == len(images)
    stages = (*config.stages, config.frame_stage) if frame_is_free else config.stages
    anchor_stage = config.all_around.anchor_stage if space.unbounded else None
    if anchor_stage:
        stages = (*stages, config.all_around.stage)
    anchored_steps = config.first.steps + (anchor_stage.steps if anchor_stage else 0)
    clock = _Clock(progress, anchored_steps + sum(stage.steps for stage in stages))

    def new_field() -> RadianceEngine:
        return new_engine(field, march, space, not space.unbounded, seed, optimiser, torch.device("cpu"))

    def learn(data: ImageTensors, stage: CoarseStage, compared: ComparedPixels | None = None) -> None:
        weights = torch.zeros(field.levels)
        weights[: stage.levels] = 1
        engine.set_level_weights(weights)
        rays = 512
        for step in range(stage.steps):
            report = engine.train_step(data.sample(rays, torch_random), 1.0)
            rays = next_rays(rays, report.samples, config.batch_samples)
            if compared and (step + 1) % config.pose_every == 0:
                move_poses(compared, stage)
                if exposure:
                    exposure.fit(engine, compared.data)
            clock.tick(f"registering, {len(state.image)} images")

    def move_poses(compared: ComparedPixels, stage: CoarseStage) -> None:
        area = (2 * stage.blur_px + 1) ** 2 * config.residual_area_px
        gauss_newton_step(
            engine, compared, state, config.rays, area, torch_random, frame_is_free=frame_is_free
        )
        state.place(compared.data)

    def tensors(stage: CoarseStage) -> ImageTensors:
        data = ImageTensors(blurred(images, stage.blur_px))
        if exposure:
            exposure.begin(data)
        return data

    engine = new_field()
    learn(_tensors(blurred(images, config.first.blur_px), anchored), config.first)
    data = tensors(config.first)
    spread_starts(engine, data, state, config.multi_start, random)
    state.place(data)
    compared = ComparedPixels(data)
    for _ in range(config.first_pose_steps):
        move_poses(compared, config.first)
    lost = np.zeros(len(state.image), dtype=bool)
    for number, stage in enumerate(stages, 1):
        if anchor_stage and number == len(stages):
            engine = new_field()
            learn(_tensors(blurred(images, anchor_stage.blur_px), anchored), anchor_stage)
            state.begin_anew()
        restart(engine, data, state, lost, config.multi_start, random)
        data = tensors(stage)
        state.place(data)
        compared = ComparedPixels(data)
        learn(data, stage, compared)
        lost = misfits(engine, compared, state, np.flatnonzero(anchored), config, torch_random)
    state.frame = FieldFrame()  # the next field is learnt where the poses are
    let_estimates_stand(images, state, space)
    return lost


def misfits(
    field: RadianceEngine,
    compared: ComparedPixels,
    state: PoseState,
    anchored: Int[NDArray, "k"],
    config: RefinementConfig,
    generator: torch.Generator,
) -> Bool[NDArray, "n"]:
    """Which uncertain images the common field explains much worse than it explains those known best."""
    T = compared.data.T_world_camera.double().numpy()
    everyone = np.arange(len(T))
    draw = compared.draw(everyone, config.rays, config.residual_area_px, generator)
    sigma = residual_sigma(residuals(field, compared.data, draw, T), draw.weight)
    return sigma[state.image] > config.most_misfit * np.median(sigma[anchored])


def _tensors(images: Sequence[CapturedImage], drawn: Bool[NDArray, "n"]) -> ImageTensors:
    """All images, only some of which are learnt from."""
    maps = [
        torch.full(image.colour.shape[:2], float(known)) for image, known in zip(images, drawn, strict=True)
    ]
    return ImageTensors(images, maps)
