"""Learn a field from images whose poses are uncertain, and correct the poses as it is learnt."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.mission.nerfstudio import write_transforms
from mulan.mission.photograph_information import PhotographInformation, write_photograph_information
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.reconstruction.captured_image import load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.refinement.anchored import anchored_images, anchored_space
from mulan.reconstruction.refinement.compared_pixels import ComparedPixels
from mulan.reconstruction.refinement.gauss_newton import PoseState
from mulan.reconstruction.refinement.pose_prior import PosePrior
from mulan.reconstruction.refinement.pose_tracker import PoseTracker
from mulan.reconstruction.refinement.posterior import (
    marginal_blocks,
    photographs_information,
    posterior_covariance,
)
from mulan.reconstruction.refinement.refinement_config import RefinementConfig
from mulan.reconstruction.refinement.registered_file import read_registered, write_registered
from mulan.reconstruction.refinement.registration import register
from mulan.reconstruction.refinement.standing_estimates import known_as_registered
from mulan.reconstruction.robot_exposure import RobotExposure
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingResult, TrainingStatus, train
from mulan.reconstruction.weights import Weighting

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


REFINED = "transforms_refined.json"
PHOTOGRAPHS = "photographs.safetensors"


@dataclass(frozen=True)
class RefinedTraining:
    """A field and the poses it was learnt from.

    Attributes:
        training: The field.
        images: The photographs at their refined poses, with the posterior's covariance.
        registration_seconds: Spent before the final field was begun.
        doubted: Images that could not be registered; the field was learnt without them, and among ``images``
            they are where localization left them.
    """

    training: TrainingResult
    images: PosedImageSet
    registration_seconds: float
    doubted: tuple[PosedImage, ...] = ()


def pose_state(images: PosedImageSet) -> PoseState | None:
    """Where the images of unsure pose are, as localization says; None if every pose is exact."""
    image = np.array(
        [i for i, each in enumerate(images.train) if each.pose_covariance is not None], dtype=int
    )
    if not len(image):
        return None
    chosen = [images.train[i] for i in image]
    names = [each.robot_id or "" for each in chosen]
    robots = sorted(set(names))
    blocks = np.stack([each.pose_covariance for each in chosen if each.pose_covariance is not None])
    joint = images.joint_pose_covariance
    prior = PosePrior(
        np.stack([each.T_world_camera for each in chosen]),
        np.array([robots.index(name) for name in names]),
        blocks if joint is None else joint,
    )
    return PoseState.at_prior(image, prior)


def at_poses(
    images: PosedImageSet, state: PoseState, covariance: Float[NDArray, "n 6 6"] | None
) -> PosedImageSet:
    """The set with its uncertain images moved; without a covariance they count as exact."""
    train = list(images.train)
    for k, i in enumerate(state.image):
        block = None if covariance is None else covariance[k]
        train[i] = replace(train[i], T_world_camera=state.T[k], pose_covariance=block)
    return replace(images, train=tuple(train), joint_pose_covariance=None)


def refine_and_train(
    images: PosedImageSet,
    weighting: Weighting,
    config: TrainConfig,
    refinement: RefinementConfig,
    run: RunFolder,
    progress: Progress,
    watch: Callable[[TrainingStatus], None] | None = None,
) -> RefinedTraining:
    """Register the uncertain images coarse to fine, then learn the field, its poses following.

    Writes ``registered.safetensors`` (poses after registration, so that an interrupted run goes on from
    there), what :func:`mulan.reconstruction.trainer.train` writes, and ``transforms_refined.json`` with the
    poses and their posterior covariance. Where robots and times are known also ``photographs.safetensors``,
    what the photographs say of the poses, for 'mulan localize --photographs'.

    Args:
        images: Photographs; those without covariance are exact and stay.
        weighting: Of the pixels in the final field.
        config: Of the final training.
        refinement: How poses are corrected.
        run: Folder to write to.
        progress: Called after every step of either part.
        watch: Called after every step of the training, off its clock.

    Raises:
        InputError: See :func:`mulan.reconstruction.trainer.train`; or no image is exact and none is better
            known than another, so nothing holds the frame.
    """
    state = pose_state(images)

    def follow(status: TrainingStatus) -> None:
        rate = status.samples / max(status.seconds, 1e-9) / 1e6
        progress(status.fraction_done, 1, f"train {status.train_psnr_db:.1f} dB, {rate:.2f} M samples/s")
        if watch:
            watch(status)

    if state is None:
        return RefinedTraining(train(images, weighting, config, run, follow), images, 0.0)
    exposure = RobotExposure(images.train, config.seed) if config.robot_exposure else None
    registered = run.root / "registered.safetensors"
    captured = load_captured(images.train, min(refinement.image_size, config.image_size))
    refinement = refinement.for_space(anchored_space(captured))
    found = read_registered(registered, state, images, refinement, config.seed, exposure)
    if found is None:
        began = time.perf_counter()
        doubted = register(captured, state, refinement, config.seed, progress, exposure)
        seconds = time.perf_counter() - began
        write_registered(registered, state, doubted, images, refinement, config.seed, seconds, exposure)
    else:
        doubted, seconds = found
    state = known_as_registered(captured, state, anchored_space(captured))
    believed, believed_state = without(images, state, doubted)
    exact = at_poses(believed, believed_state, None)
    tracker = None
    if len(believed_state.T):
        stays = np.ones(len(captured), dtype=bool)
        stays[state.image[doubted]] = False
        tracker = PoseTracker(believed_state, refinement, config.seed, anchored_images(captured)[stays])
    training = train(exact, weighting, config, run, follow, between_steps=tracker, exposure=exposure)
    state.T[~doubted], state.T[doubted] = believed_state.T, state.prior.T_world_camera[doubted]
    covariance = state.prior.blocks.copy()
    if len(believed_state.T):
        data = ImageTensors(load_captured(believed.train, config.image_size))
        believed_state.place(data)
        if exposure:
            exposure.begin(data)
        information = photographs_information(
            training.engine, ComparedPixels(data), believed_state, refinement, config.seed + 5
        )
        covariance[~doubted] = marginal_blocks(posterior_covariance(believed_state.prior, information))
        _hand_to_localization(believed, believed_state, information, run)
    refined = at_poses(images, state, covariance)
    write_transforms(refined, run.root / REFINED)
    left_out = tuple(images.train[i] for i in state.image[doubted])
    return RefinedTraining(training, refined, seconds, left_out)


def _hand_to_localization(
    images: PosedImageSet, state: PoseState, information: Float[NDArray, "m m"], run: RunFolder
) -> None:
    chosen = [images.train[i] for i in state.image]
    robots = [image.robot_id for image in chosen if image.robot_id is not None]
    time_s = [image.timestamp_s for image in chosen if image.timestamp_s is not None]
    if len(robots) == len(time_s) == len(chosen):
        found = PhotographInformation(tuple(robots), np.array(time_s), state.T, information)
        write_photograph_information(found, run.root / PHOTOGRAPHS)


def without(
    images: PosedImageSet, state: PoseState, doubted: Bool[NDArray, "n"]
) -> tuple[PosedImageSet, PoseState]:
    """The set without its doubted images, and the poses of those of its images that are not exact."""
    stays = np.ones(len(images.train), dtype=bool)
    stays[state.image[doubted]] = False
    number = np.cumsum(stays) - 1
    train = tuple(image for image, stay in zip(images.train, stays, strict=True) if stay)
    kept = replace(images, train=train, joint_pose_covariance=None)
    return kept, state.subset(~doubted, number[state.image[~doubted]])


def image_names(images: Sequence[PosedImage]) -> list[str]:
    """Their robots and files, for a person."""
    return [f"{image.robot_id}/{image.path.name}" if image.robot_id else image.path.name for image in images]


def median_correction_m(before: PosedImageSet, after: PosedImageSet) -> float:
    """Median distance uncertain cameras were moved by [m]; 0 if there are none."""
    moved_m = [
        float(np.linalg.norm(b.T_world_camera[:3, 3] - a.T_world_camera[:3, 3]))
        for b, a in zip(before.train, after.train, strict=True)
        if b.pose_covariance is not None
    ]
    return float(np.median(moved_m)) if moved_m else 0.0
