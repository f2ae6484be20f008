"""From localized robots to the posed image set reconstruction learns from."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.types import Localization
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.types import Mission

HELD_OUT = "held_out"
"""Key of the test photographs among the extracted files."""


def held_out_images(
    mission: Mission, files: Mapping[str, Sequence[Path]], T_world_truth: Float[NDArray, "4 4"]
) -> tuple[PosedImage, ...]:
    """The mission's test photographs, their true camera poses moved into the anchor's start frame."""
    views = mission.held_out
    if views is None:
        return ()
    return tuple(
        PosedImage(path, views.camera, T_world_truth @ T, robot_id=HELD_OUT, timestamp_s=photo.time_s)
        for path, T, photo in zip(files[HELD_OUT], views.T_world_camera, views.photos, strict=True)
    )


def localized_images(
    mission: Mission,
    localization: Localization,
    files: Mapping[str, Sequence[Path]],
    T_world_truth: Float[NDArray, "4 4"] | None,
    hold_out_every: int = 8,
) -> PosedImageSet:
    """Every placed robot's photographs at their estimated camera poses, with covariance.

    Args:
        mission: What was recorded.
        localization: Body poses and covariances at the photographs.
        files: Extracted image files by robot name (and ``held_out``), in the order of the photographs.
        T_world_truth: Frame of the ground truth in the anchor's start frame, where known; it places the
            mission's own test photographs.
        hold_out_every: Where the mission has no test photographs, every n-th photograph of each robot is held
            out instead, at its *estimated* pose; 0 holds out none.
    """
    train: list[PosedImage] = []
    test = list(held_out_images(mission, files, T_world_truth)) if T_world_truth is not None else []
    own_test = bool(test)
    before, photograph, adjoint = (
        0,
        [],
        [],
    )  # where those to learn from are among all, and how bodies move them
    for robot in mission.robots:
        trajectory = localization.trajectories.get(robot.name)
        if trajectory is None:
            continue
        T_world_camera = trajectory.T_world_body @ robot.T_body_camera
        covariance = se3.covariance_of_composition(
            np.broadcast_to(robot.T_body_camera, T_world_camera.shape), trajectory.covariance
        )
        for i, path in enumerate(files[robot.name]):
            image = PosedImage(
                path, robot.camera, T_world_camera[i], covariance[i], robot.name, float(trajectory.time_s[i])
            )
            held_out = not own_test and hold_out_every > 0 and i % hold_out_every == hold_out_every // 2
            (test if held_out else train).append(image)
            if not held_out:
                photograph.append(before + i)
                adjoint.append(se3.adjoint(se3.inverse(robot.T_body_camera)))
        before += len(files[robot.name])
    joint = None
    if localization.joint_covariance is not None and photograph:
        n, A = len(localization.joint_covariance) // 6, np.stack(adjoint)
        bodies = localization.joint_covariance.reshape(n, 6, n, 6)[photograph][:, :, photograph]
        joint = np.einsum("iab,ibjc,jdc->iajd", A, bodies, A, optimize=True).reshape(6 * len(A), 6 * len(A))
    return PosedImageSet(tuple(train), tuple(test), files[mission.robots[0].name][0].parent.parent, joint)
