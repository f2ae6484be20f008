"""Which images a registration may start from: those whose poses are known best."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool
from numpy.typing import NDArray

from mulan.radiance.space import SceneSpace
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.scene_space import choose_space

_HOLDS = 0.25  # of the median image's standard deviation of position
_FEW = 0.1  # of the images


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


def frame_holders(images: Sequence[CapturedImage]) -> Bool[NDArray, "n"]:
    """The few images known so much better than all others that the world's frame hangs on them alone.

    A field learnt from such an image bends towards it wherever its frame lies, and the error would stay; what
    the others say of the same place tells. None if they are more than a few: a field could not do without
    them.
    """
    spread_m = np.array([position_sigma_m(image) for image in images])
    holders = spread_m < _HOLDS * np.median(spread_m)
    return holders if holders.mean() <= _FEW else np.zeros_like(holders)
