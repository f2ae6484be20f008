"""Refined camera poses as one factor between all keyframes that stand at photographs."""

from collections.abc import Mapping, Sequence

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.geometry import se3
from mulan.localization.keyframes import Keyframes
from mulan.mission.photograph_information import PhotographInformation
from mulan.mission.types import RobotLog

_SAME_INSTANT_S = 1e-6


def photograph_factor(
    found: PhotographInformation,
    robots: Sequence[RobotLog],
    keyframes: Mapping[str, Keyframes],
    key_of: Mapping[str, int],
) -> gtsam.NonlinearFactor | None:
    """The quadratic about the refined poses, in the axes of the bodies.

    Robots that are not among the keyframes are left out (their photographs' poses marginalised); None if
    none is left.

    Args:
        found: What refinement said.
        robots: Their cameras.
        keyframes: Of the placed robots.
        key_of: Key of each robot's first keyframe; the others follow.

    Raises:
        InputError: A photograph is of no robot of the mission, or no keyframe stands at it.
    """
    logs = {robot.name: robot for robot in robots}
    for name in found.robots:
        if name not in logs:
            raise InputError(
                "photographs",
                f"robot '{name}'",
                "is not in the bag",
                "refine photographs of the same mission",
            )
    kept = np.array([name in keyframes for name in found.robots])
    if not kept.any():
        return None
    information = _marginal(found.information, kept)
    index = [
        (name, _keyframe(keyframes[name], time_s))
        for name, time_s, stays in zip(found.robots, found.time_s, kept, strict=True)
        if stays
    ]
    keys = [key_of[name] + i for name, i in index]
    T_body_camera = np.stack([logs[name].T_body_camera for name, _ in index])
    values = gtsam.Values()
    for key, T in zip(keys, found.T_world_camera[kept] @ se3.inverse(T_body_camera), strict=True):
        values.insert(key, gtsam.Pose3(T))
    A = se3.adjoint(se3.inverse(T_body_camera))  # how a body's perturbation moves its camera
    return gtsam.LinearContainerFactor(_quadratic(information, A, keys), values)


def _quadratic(
    information: Float[NDArray, "m m"], A: Float[NDArray, "n 6 6"], keys: Sequence[int]
) -> gtsam.HessianFactor:
    n, zero = len(keys), np.zeros(6)
    blocks = information.reshape(n, 6, n, 6)
    parts = gtsam.GaussianFactorGraph()
    for i in range(n):
        own = A[i].T @ blocks[i, :, i] @ A[i]
        parts.add(gtsam.HessianFactor(keys[i], (own + own.T) / 2, zero, 0.0))
        for j in range(i + 1, n):
            between = A[i].T @ blocks[i, :, j] @ A[j]
            none = np.zeros((6, 6))
            parts.add(gtsam.HessianFactor(keys[i], keys[j], none, between, zero, none, zero, 0.0))
    return gtsam.HessianFactor(parts)


def _marginal(information: Float[NDArray, "m m"], kept: NDArray[np.bool_]) -> Float[NDArray, "k k"]:
    """Information on some poses where the others are unknown."""
    rows = np.repeat(kept, 6)
    own, cross, other = (
        information[np.ix_(rows, rows)],
        information[rows][:, ~rows],
        information[~rows][:, ~rows],
    )
    return own - cross @ np.linalg.pinv(other, hermitian=True) @ cross.T if len(other) else own


def _keyframe(keyframes: Keyframes, time_s: float) -> int:
    index = keyframes.nearest(time_s)
    if abs(float(keyframes.time_s[index]) - time_s) > _SAME_INSTANT_S:
        problem = f"no pose of {keyframes.robot} is estimated at {time_s:.3f} s"
        raise InputError(
            "photographs",
            "time",
            problem,
            "make every photograph a keyframe (--graph.photo-keyframe-every-m 0)",
        )
    return index
