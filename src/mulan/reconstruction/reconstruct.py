"""Learn a field, score it on the held-out views, write both to the run."""

import hashlib
import json
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import RunFolder, read_json, write_json
from mulan.reconstruction.held_out import evaluate_held_out
from mulan.reconstruction.process_group import ProcessGroup
from mulan.reconstruction.refinement.refine import image_names, median_correction_m, refine_and_train
from mulan.reconstruction.refinement.refinement_config import RefinementConfig
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.trainer import TrainingStatus, train
from mulan.reconstruction.weights import Weighting

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


def reconstruct(
    images: PosedImageSet,
    weighting: Weighting,
    config: TrainConfig,
    run: RunFolder,
    progress: Progress,
    group: ProcessGroup | None = None,
    refinement: RefinementConfig | None = None,
    watch: Callable[[TrainingStatus], None] | None = None,
) -> dict[str, Any]:
    """Train and evaluate; a run already finished with the same images and options is kept as it is.

    With ``refinement`` the poses that carry a covariance are corrected as the field is learnt
    (``transforms_refined.json``), by one process.

    ``watch`` is called after every step, off the training clock.

    Each process of ``group`` calls this with the same arguments; all learn, the leader writes and evaluates.

    Returns:
        What it writes to metrics.json: ``psnr_db``, ``ssim`` (None without held-out views), ``views``,
        ``train_seconds``, ``steps``, ``samples_per_s``, ``made_from``; with refinement also
        ``registration_seconds``, ``median_correction_m`` and ``doubted``, the names of the images left out;
        where cameras differ, ``robot_gains`` for red, green and blue by robot.

    Raises:
        InputError: See :func:`mulan.reconstruction.trainer.train`; or several processes were to refine poses.
    """
    leads, finished = group is None or group.leads, None
    made_from = fingerprint(images, weighting, config)
    if refinement:
        made_from += f"-{hashlib.sha256(f'{refinement}'.encode()).hexdigest()[:8]}"
    if group:
        made_from += f"x{group.place.processes}"
    with group.all_or_none() if group else nullcontext():
        if leads:
            run.check_writable()
            finished = _finished(run, made_from)
    if group:
        finished = group.broadcast_json(finished)
    if finished:
        progress(1, 1, "finished earlier")
        return finished

    def follow(status: TrainingStatus) -> None:
        rate = status.samples / max(status.seconds, 1e-9) / 1e6
        progress(status.fraction_done, 1, f"train {status.train_psnr_db:.1f} dB, {rate:.2f} M samples/s")
        if watch:
            watch(status)

    metrics: dict[str, Any] = {}
    if refinement:
        if group:
            remedy = "train in one process, or leave poses as they are"
            raise InputError("--refine-poses", "torchrun", "several processes cannot refine poses", remedy)
        refined = refine_and_train(images, weighting, config, refinement, run, progress, watch)
        result = refined.training
        metrics |= {
            "registration_seconds": refined.registration_seconds,
            "median_correction_m": median_correction_m(images, refined.images),
            "doubted": image_names(refined.doubted),
        }
    else:
        result = train(images, weighting, config, run, follow, group)
    progress(1, 1, "rendering held-out views")
    metrics |= {
        "train_seconds": result.seconds,
        "steps": result.steps,
        "samples_per_s": result.samples / max(result.seconds, 1e-9),
        "made_from": made_from,
    }
    if result.exposure:
        metrics["robot_gains"] = dict(result.exposure.gains)
    with group.all_or_none() if group else nullcontext():
        if leads:
            sub_pixels = result.description.sub_pixels
            metrics |= evaluate_held_out(
                result.engine, result.test, run, sub_pixels=sub_pixels, exposure=result.exposure
            )
            write_json(run.metrics, metrics)
    return group.broadcast_json(metrics) if group else metrics


def _finished(run: RunFolder, made_from: str) -> dict[str, Any] | None:
    """Metrics of a run finished with the same images and options."""
    if run.metrics.exists() and run.field.exists():
        metrics = read_json(run.metrics, "mulan train")
        if metrics.get("made_from") == made_from:
            return metrics
    return None


def fingerprint(images: PosedImageSet, weighting: Weighting, config: TrainConfig) -> str:
    """A digest of everything a reconstruction depends on: image files, poses, covariances, options."""
    digest = hashlib.sha256(f"{weighting} {json.dumps(config.what_is_learnt(), sort_keys=True)}".encode())
    if images.joint_pose_covariance is not None:
        digest.update(images.joint_pose_covariance.tobytes())
    for image in (*images.train, *images.test):
        digest.update(_image_bytes(image))
    return digest.hexdigest()[:16]


def _image_bytes(image: PosedImage) -> bytes:
    stat = image.path.stat() if image.path.exists() else None
    covariance = b"" if image.pose_covariance is None else image.pose_covariance.tobytes()
    size = f"{image.path.name} {stat.st_size if stat else -1} {image.camera}"
    return size.encode() + image.T_world_camera.tobytes() + covariance
