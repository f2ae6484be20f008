"""Which images a registration may start from: those whose poses are known best."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool
from numpy.typing import NDArray

from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.scene_space import choose_space


def anchored_images(images: Sequence[CapturedImage]) -> Bool[NDArray, "n"]:
    """Images of the robot whose positions are known best, and all exact ones."""
    spread_m = np.array([position_sigma_m(image) for image in images])
    names = np.array([image.posed.robot_id or "" for image in images])
    robots = np.unique(names)
    best = min(robots, key=lambda robot: float(np.median(spread_m[names == robot])))
    exact = spread_m == 0
    # a set without robots' names has its exact images, or else all of them
    return exact | (names == best) if len(robots) > 1 or not exact.any() else exact


def position_sigma_m(image: CapturedImage) -> float:
    """Root mean square of the position's standard deviations [m]; 0 for an exact pose."""
    covariance = image.posed.pose_covariance
    return 0.0 if covariance is None else float(np.sqrt(max(np.trace(covariance[3:, 3:]) / 3, 0.0)))


def anchored_space(images: Sequence[CapturedImage]) -> SceneSpace:
    """Where the scene is, as those images see it."""
    known = anchored_images(images)
    return choose_space([image for image, anchored in zip(images, known, strict=True) if anchored])
