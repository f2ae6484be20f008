"""What eliminated keyframes say about those that remain, wherever the team turned out to be.

A linear prior over poses in a common frame, kept as it was linearised, gains information it never had: the
direction "the whole team turns about the vertical" is another one at the poses it was linearised about than
at the poses it is used at, and relative measurements then pull the team about. So one pose is the reference;
the prior holds the others as they are seen from it, and only the reference in the world.
"""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3


def relative_prior(
    linear: gtsam.GaussianFactorGraph, values: gtsam.Values, poses: Sequence[int], constants: Sequence[int]
) -> gtsam.CustomFactor:
    """The linear graph as one factor over poses relative to the first of them.

    Args:
        linear: Over perturbations (right) of the poses and over the constants.
        values: Where it was linearised.
        poses: Keys of poses, all that ``linear`` has; the first becomes the reference.
        constants: Keys of one-dimensional constants, all that ``linear`` has.
    """
    keys = [*poses, *constants]
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    A, b = _triangular(*linear.jacobian(ordering))
    n = len(poses)
    by_pose = [A[:, 6 * i : 6 * i + 6] for i in range(n)]
    by_constant = A[:, 6 * n :]
    T0 = np.array([values.atPose3(key).matrix() for key in poses])
    constant0 = np.array([values.atVector(key)[0] for key in constants])
    seen0 = se3.inverse(T0[0]) @ T0[1:]  # from the reference
    # a perturbation of a pose is its own relative to the reference plus the reference's, carried over
    by_reference = by_pose[0] + sum(
        (of @ se3.adjoint(se3.inverse(seen)) for of, seen in zip(by_pose[1:], seen0, strict=True)),
        start=np.zeros((len(A), 6)),
    )
    reference0, seen0_inverse = gtsam.Pose3(T0[0]), [gtsam.Pose3(T).inverse() for T in seen0]

    def error(_factor: gtsam.CustomFactor, now: gtsam.Values, jacobians: Any) -> NDArray:
        reference = now.atPose3(poses[0])
        off = reference0.between(reference)
        residual = by_reference @ gtsam.Pose3.Logmap(off) - b
        of_reference = by_reference @ gtsam.Pose3.LogmapDerivative(off)
        for i in range(1, n):
            pose = now.atPose3(poses[i])
            seen = reference.between(pose)
            off = seen0_inverse[i - 1].compose(seen)
            residual += by_pose[i] @ gtsam.Pose3.Logmap(off)
            if jacobians is not None:
                own = by_pose[i] @ gtsam.Pose3.LogmapDerivative(off)
                jacobians[i] = np.asfortranarray(own)
                of_reference -= own @ seen.inverse().AdjointMap()
        if constants:
            residual += by_constant @ (np.array([now.atVector(key)[0] for key in constants]) - constant0)
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(of_reference)
            for k in range(len(constants)):
                jacobians[n + k] = np.asfortranarray(by_constant[:, k : k + 1])
        return residual

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(A)), keys, error)


def _triangular(
    A: Float[NDArray, "m n"], b: Float[NDArray, "m"]
) -> tuple[Float[NDArray, "k n"], Float[NDArray, "k"]]:
    """The same normal equations with as few rows as unknowns."""
    if len(A) <= A.shape[1]:
        return A, b
    R = np.asarray(np.linalg.qr(np.column_stack([A, b]), mode="r"))
    return R[: A.shape[1], :-1], R[: A.shape[1], -1]
