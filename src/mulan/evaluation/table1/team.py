"""Two robots that share a set of photographs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.simulation.from_images import share_views

ALPHA, BETA = "alpha", "beta"
FIFTEEN = 15


class Split(Enum):
    """Who takes which photograph."""

    AZIMUTH = "azimuth"
    """Each robot half of the directions around the scene."""
    RANDOM = "random"
    """Drawn by lot, half each."""
    FIFTEEN = "fifteen"
    """15 each, drawn by lot from the halves by azimuth."""


@dataclass(frozen=True)
class Team:
    """The photographs of a team, at their true poses and at those its robots believe.

    Attributes:
        true: At their true poses.
        believed: The same photographs in the same order, at estimated poses with covariance.
        anchor: Robot whose photographs alone are the baseline of setup ``alone``.
    """

    true: PosedImageSet
    believed: PosedImageSet
    anchor: str


def share_photographs(
    images: PosedImageSet, split: Split, rng: np.random.Generator
) -> tuple[tuple[PosedImage, ...], tuple[PosedImage, ...]]:
    """The training views of alpha and of beta, each in the order of the set, named after their robot.

    Raises:
        InputError: The set is too small for the split.
    """
    needed = 2 * FIFTEEN if split is Split.FIFTEEN else 2
    if len(images.train) < needed:
        problem = f"{len(images.train)} are too few for the split '{split.value}'"
        raise InputError(images.source, "training images", problem, f"name a set of at least {needed}")
    T = np.stack([image.T_world_camera for image in images.train])
    halves = share_views(T, 2, "random" if split is Split.RANDOM else "azimuth", rng)
    if split is Split.FIFTEEN:
        halves = [rng.choice(half, FIFTEEN, replace=False) for half in halves]
    alpha, beta = (
        tuple(replace(images.train[i], robot_id=name, pose_covariance=None) for i in sorted(half))
        for name, half in zip((ALPHA, BETA), halves, strict=True)
    )
    return alpha, beta


def of_robot(images: PosedImageSet, robot: str) -> PosedImageSet:
    """Only one robot's training views, and the joint covariance of those."""
    kept = tuple(image for image in images.train if image.robot_id == robot)
    joint = images.joint_pose_covariance
    if joint is not None:
        uncertain = [image.robot_id == robot for image in images.train if image.pose_covariance is not None]
        rows = np.repeat(uncertain, 6)
        joint = joint[np.ix_(rows, rows)] if rows.any() else None
    return replace(images, train=kept, joint_pose_covariance=joint)


def without_covariance(images: PosedImageSet) -> PosedImageSet:
    """The same images, their poses taken as exact."""
    train: Sequence[PosedImage] = [replace(image, pose_covariance=None) for image in images.train]
    return replace(images, train=tuple(train), joint_pose_covariance=None)
