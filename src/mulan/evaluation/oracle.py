"""The same photographs at their true poses: the upper bound every setup is compared with."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.posed_images import held_out_images
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.types import Mission, RobotLog


def true_camera_poses(robot: RobotLog) -> Float[NDArray, "n 4 4"]:
    """True camera pose of each photograph, in the frame of the ground truth.

    Raises:
        InputError: The robot has no ground truth.
    """
    truth = robot.ground_truth
    if truth is None:
        raise InputError(
            f"/{robot.name}/ground_truth",
            "topic",
            "is absent",
            "the oracle needs true poses; simulate the mission",
        )
    return se3.interpolate(truth.time_s, truth.T_world_body, robot.photo_time_s) @ robot.T_body_camera


def oracle_images(
    mission: Mission, files: Mapping[str, Sequence[Path]], T_world_truth: Float[NDArray, "4 4"]
) -> PosedImageSet:
    """Every robot's photographs at their true poses, moved into the anchor's start frame."""
    train = [
        PosedImage(path, robot.camera, T_world_truth @ T, None, robot.name, float(time_s))
        for robot in mission.robots
        for path, T, time_s in zip(
            files[robot.name], true_camera_poses(robot), robot.photo_time_s, strict=True
        )
    ]
    test = held_out_images(mission, files, T_world_truth)
    return PosedImageSet(tuple(train), test, files[mission.robots[0].name][0].parent.parent)


def camera_rms_m(images: PosedImageSet, oracle: PosedImageSet) -> float:
    """Root mean square distance between estimated and true camera positions."""
    estimated = np.array([image.T_world_camera[:3, 3] for image in images.train])
    true = np.array([image.T_world_camera[:3, 3] for image in oracle.train])
    return float(np.sqrt(((estimated - true) ** 2).sum(1).mean()))
