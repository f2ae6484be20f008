"""One setup of one seed: learnt, scored, kept."""

import hashlib
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mulan.evaluation.table1.camera_errors import camera_errors
from mulan.evaluation.table1.ours import refinement_options, train_refined
from mulan.evaluation.table1.setups import Setup
from mulan.evaluation.table1.sources import Progress
from mulan.evaluation.table1.team import Team
from mulan.geometry.alignment import umeyama
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.held_out import ViewJudge, evaluate_held_out, psnr_db
from mulan.reconstruction.reconstruct import fingerprint
from mulan.reconstruction.refinement.refine import image_names
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingResult, TrainingStatus, train

NEEDED_TO_ALIGN = 3  # cameras


def made_from(setup: Setup, team: Team, config: TrainConfig) -> str:
    """A digest of everything a setup's figures depend on."""
    digest = fingerprint(setup.images(team), setup.weighting, config)
    if setup.refines:
        digest += f"-{hashlib.sha256(refinement_options().encode()).hexdigest()[:8]}"
    return digest


def finished_setup(setup: Setup, team: Team, config: TrainConfig, run: RunFolder) -> dict[str, Any] | None:
    """Figures of a setup finished earlier with the same images and options, or None."""
    if not (run.metrics.exists() and run.field.exists()):
        return None
    figures = read_json(run.metrics, "mulan evaluate table1")
    return figures if figures.get("made_from") == made_from(setup, team, config) else None


def trained_setup(
    setup: Setup,
    team: Team,
    config: TrainConfig,
    run: RunFolder,
    judges: Sequence[ViewJudge],
    progress: Progress,
) -> dict[str, Any]:
    """Learn one setup and score it on the held-out views; goes on where an earlier call was stopped.

    Args:
        setup: What to learn.
        team: Photographs and poses.
        config: Training options, the same for every setup.
        run: Folder of this setup.
        judges: Figures of merit besides PSNR and SSIM.
        progress: Follows the training.

    Returns:
        What it writes to the folder's metrics.json: means over the views (``psnr_db`` raw,
        ``aligned_psnr_db``), camera errors, ``train_seconds``, ``wall_seconds`` (reading files and preparing
        poses included, scoring excluded), ``steps``, ``views``, ``doubted`` (images refinement left out),
        ``made_from``.

    Raises:
        InputError: See :func:`mulan.reconstruction.trainer.train`.
    """
    run.check_writable()
    began = time.perf_counter()
    training, ended_with, registration_s, doubted = _learn(setup, setup.images(team), config, run, progress)
    wall_s = time.perf_counter() - began
    progress(1, 1, "rendering held-out views")
    write_transforms(ended_with, run.transforms)
    sub_pixels = training.description.sub_pixels
    figures = {
        **evaluate_held_out(
            training.engine,
            training.test,
            run,
            sub_pixels=sub_pixels,
            judges=judges,
            exposure=training.exposure,
        ),
        **camera_errors(team, ended_with),
        "train_seconds": training.seconds + registration_s,
        "wall_seconds": wall_s,
        "steps": training.steps,
        "doubted": doubted,
        "made_from": made_from(setup, team, config),
    }
    figures["aligned_psnr_db"] = aligned_psnr_db(training, team.true, ended_with, figures["psnr_db"])
    write_json(run.metrics, figures)
    return figures


def _learn(
    setup: Setup, images: PosedImageSet, config: TrainConfig, run: RunFolder, progress: Progress
) -> tuple[TrainingResult, PosedImageSet, float, list[str]]:
    """The field, the poses it ended with, seconds spent on poses before it was begun, images left out."""
    if setup.refines:
        refined = train_refined(images, setup.weighting, config, run, progress)
        names = image_names(refined.doubted)
        return refined.training, refined.images, refined.registration_seconds, names

    def follow(status: TrainingStatus) -> None:
        progress(status.fraction_done, 1, f"train {status.train_psnr_db:.1f} dB, {status.steps} steps")

    return train(images, setup.weighting, config, run, follow), images, 0.0, []


def aligned_psnr_db(
    training: TrainingResult, true: PosedImageSet, images: PosedImageSet, raw_psnr_db: float
) -> float:
    """PSNR with the held-out cameras moved along with the scene.

    The similarity that best takes the true positions of the training cameras to those the field was learnt
    with (Umeyama) takes the held-out cameras too: only the shape of the team's map is judged, not its place.
    """
    true_m = {image.path: image.T_world_camera[:3, 3] for image in true.train}
    source = np.stack([true_m[image.path] for image in images.train])
    target = np.stack([image.T_world_camera[:3, 3] for image in images.train])
    if len(source) < NEEDED_TO_ALIGN or np.array_equal(source, target):
        return raw_psnr_db
    T, scale = umeyama(source, target, with_scale=True)

    def moved(view: CapturedImage) -> CapturedImage:
        pose = view.T_world_camera.copy()
        pose[:3, 3] *= scale
        return replace(view, posed=replace(view.posed, T_world_camera=T @ pose))

    views = [ImageTensors([moved(view)]) for view in training.test]
    scores = [psnr_db(training.engine, view, 0, training.description.sub_pixels) for view in views]
    return sum(scores) / len(scores)
