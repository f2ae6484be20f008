"""The paper's comparison on one mission: true poses, wireless poses, wireless poses with weights."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mulan.errors import InputError
from mulan.evaluation.oracle import camera_rms_m, oracle_images
from mulan.evaluation.provenance import provenance
from mulan.localization.accuracy import world_from_truth
from mulan.localization.localize import LocalizationConfig, localize
from mulan.localization.posed_images import localized_images
from mulan.localization.run_files import write_localization
from mulan.mission.extract import extract_photos
from mulan.mission.nerfstudio import write_transforms
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder, write_json
from mulan.mission.types import Mission
from mulan.reconstruction.reconstruct import reconstruct
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import NoWeights, UncertaintyWeights, Weighting
from mulan.wireless.bearing import BearingConfig

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""


def compare_setups(
    mission: Mission,
    run: RunFolder,
    config: TrainConfig,
    localization_config: LocalizationConfig,
    bearing_config: BearingConfig,
    stage: Callable[[str], Progress],
) -> dict[str, Any]:
    """Localize once, train the three setups, score each on the mission's held-out views.

    Setups A, B, C of the paper's simulation experiment: ``oracle`` (true poses), ``wireless`` (poses from
    odometry and radio), ``uncertainty`` (the same poses, each pixel weighted by what its pose deserves).
    A setup that already finished with the same options is kept, an interrupted one goes on.

    Args:
        mission: With ground truth and held-out views.
        run: The localization goes here, each setup into a folder of its own below.
        config: Training options, the same for every setup.
        localization_config: Options of the factor graph.
        bearing_config: Options of the radio bearings.
        stage: Called with a stage's title, gives the callback that follows its progress.

    Returns:
        What it writes to metrics.json.
    """
    T_world_truth = world_from_truth(mission)
    if T_world_truth is None:
        remedy = "the oracle needs true poses; simulate the mission"
        raise InputError(f"/{mission.robots[0].name}/ground_truth", "topic", "is absent", remedy)
    files = extract_photos(mission, run)
    localization = localize(mission, localization_config, bearing_config, stage("Localizing"))
    localization.require_all_placed()
    write_localization(localization, mission, run)
    oracle = oracle_images(mission, files, T_world_truth)
    estimated = localized_images(mission, localization, files, T_world_truth)
    setups: dict[str, tuple[str, PosedImageSet, Weighting]] = {
        "oracle": ("Training on true poses", oracle, NoWeights()),
        "wireless": ("Training on wireless poses", without_covariance(estimated), NoWeights()),
        "uncertainty": ("Training with weights", estimated, UncertaintyWeights()),
    }
    estimated_rms_m = camera_rms_m(estimated, oracle)
    result: dict[str, Any] = {"setups": {}, "provenance": provenance(config.seed)}
    for name, (title, images, weighting) in setups.items():
        setup_run = RunFolder(run.root / name)
        write_transforms(images, setup_run.transforms)
        metrics = reconstruct(images, weighting, config, setup_run, stage(title))
        result["setups"][name] = {
            "psnr_db": metrics["psnr_db"],
            "ssim": metrics["ssim"],
            "camera_rms_m": 0.0 if name == "oracle" else estimated_rms_m,
            "train_seconds": metrics["train_seconds"],
            "steps": metrics["steps"],
        }
        write_json(run.metrics, result)
    return result


def without_covariance(images: PosedImageSet) -> PosedImageSet:
    """The same images, their poses taken as exact."""
    return PosedImageSet(
        tuple(replace(image, pose_covariance=None) for image in images.train), images.test, images.source
    )
