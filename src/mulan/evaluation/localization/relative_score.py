"""Where one robot is in another's axes: estimates against truth, and whether the covariance says so."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3
from mulan.localization.graph import LocalizationGraph
from mulan.localization.marginals import TeamMarginals
from mulan.localization.solve import Solution


@dataclass(frozen=True)
class RelativeErrors:
    """Errors of the pose of one robot in another's body frame, one row an instant.

    Attributes:
        pair: The two names.
        time_s: Instants.
        off_m: Estimated minus true position, in the first one's body axes.
        yaw_rad: Error about the vertical.
        squared: Squared Mahalanobis length over position and yaw (4 freedoms); None without a covariance.
        squared_full: Over all six.
        claimed_m2: Claimed variance of the position, all axes together.
        claimed_rad2: Claimed variance of the yaw.
    """

    pair: tuple[str, str]
    time_s: Float[NDArray, "n"]
    off_m: Float[NDArray, "n 3"]
    yaw_rad: Float[NDArray, "n"]
    squared: Float[NDArray, "n"] | None = None
    squared_full: Float[NDArray, "n"] | None = None
    claimed_m2: Float[NDArray, "n"] | None = None
    claimed_rad2: Float[NDArray, "n"] | None = None


def _mahalanobis(x: Float[NDArray, "n d"], covariance: Float[NDArray, "n d d"]) -> Float[NDArray, "n"]:
    return np.einsum("nd,nd->n", x, np.linalg.solve(covariance, x[..., None])[..., 0])


def relative_errors(
    pair: tuple[str, str],
    time_s: Float[NDArray, "n"],
    estimate: tuple[Float[NDArray, "n 4 4"], Float[NDArray, "n 4 4"]],
    truth: tuple[Float[NDArray, "n 4 4"], Float[NDArray, "n 4 4"]],
    covariance: Float[NDArray, "n 6 6"] | None = None,
) -> RelativeErrors:
    """Compare ``T_first_second``; neither side's world frame matters.

    Args:
        pair: Names.
        time_s: Instants.
        estimate: Poses of the two robots in any common frame.
        truth: The same in any other common frame.
        covariance: Of the estimated ``T_first_second``, right perturbation.
    """
    E = se3.inverse(estimate[0]) @ estimate[1]
    true = se3.inverse(truth[0]) @ truth[1]
    # seen along the second robot's true vertical, which is the first one's too
    up = np.swapaxes(truth[1][:, :3, :3], 1, 2)[:, :, 2]
    xi = se3.log(se3.inverse(E) @ true)
    yaw = -(xi[:, :3] * up).sum(1)
    errors = RelativeErrors(pair, time_s, E[:, :3, 3] - true[:, :3, 3], yaw)
    if covariance is None:
        return errors
    P = np.zeros((len(xi), 4, 6))
    P[:, 0, :3] = up
    P[:, [1, 2, 3], [3, 4, 5]] = 1.0
    claimed = P @ covariance @ np.swapaxes(P, 1, 2)
    return replace(
        errors,
        squared=_mahalanobis((P @ xi[..., None])[..., 0], claimed),
        squared_full=_mahalanobis(xi, covariance),
        claimed_m2=np.einsum("nii->n", claimed[:, 1:, 1:]),
        claimed_rad2=claimed[:, 0, 0],
    )


def solved_pair(
    graph: LocalizationGraph,
    solution: Solution,
    marginals: TeamMarginals,
    pair: tuple[str, str],
    time_s: Float[NDArray, "n"],
) -> tuple[Float[NDArray, "n 4 4"], Float[NDArray, "n 4 4"], Float[NDArray, "n 6 6"]]:
    """Poses of two robots at keyframes they share, and the covariance of one in the other's frame.

    From the joint marginal of both: errors they share cancel.
    """
    poses: tuple[list[NDArray], list[NDArray]] = ([], [])
    covariance = []
    ends_at = [[(name, graph.robots[name].nearest(float(t))) for name in pair] for t in time_s]
    keyframes = list(dict.fromkeys(end for ends in ends_at for end in ends))
    joint = marginals.joint_of_many(keyframes)
    row = {keyframe: 6 * i for i, keyframe in enumerate(keyframes)}
    for ends in ends_at:
        T_a, T_b = (solution.values.atPose3(graph.key(*end)).matrix() for end in ends)
        J = np.concatenate([-se3.adjoint(se3.inverse(T_b) @ T_a), np.eye(6)], 1)
        rows = np.concatenate([np.arange(row[end], row[end] + 6) for end in ends])
        covariance.append(J @ joint[np.ix_(rows, rows)] @ J.T)
        poses[0].append(T_a)
        poses[1].append(T_b)
    return np.array(poses[0]), np.array(poses[1]), np.array(covariance)


def figures(errors: Sequence[RelativeErrors]) -> dict[str, Any]:
    """Root mean squares and NEES over all instants of all pairs, for JSON."""
    off = np.concatenate([e.off_m for e in errors])
    yaw = np.concatenate([e.yaw_rad for e in errors])
    length = np.linalg.norm(off, axis=1)
    result: dict[str, Any] = {
        "rms_m": float(np.sqrt((length**2).mean())),
        "worst_m": float(length.max()),
        "yaw_rms_deg": float(np.degrees(np.sqrt((yaw**2).mean()))),
        "instants": len(yaw),
    }
    squared = [e.squared for e in errors if e.squared is not None]
    full = [e.squared_full for e in errors if e.squared_full is not None]
    if squared:
        result["nees_per_dof"] = float(np.concatenate(squared).mean() / 4)
        result["nees_per_dof_with_tilt"] = float(np.concatenate(full).mean() / 6)
    of_place = [e.claimed_m2 for e in errors if e.claimed_m2 is not None]
    of_yaw = [e.claimed_rad2 for e in errors if e.claimed_rad2 is not None]
    if of_yaw and of_place:
        variance = np.concatenate(of_yaw)
        result["claimed_rms_m"] = float(np.sqrt(np.concatenate(of_place).mean()))
        result["claimed_yaw_rms_deg"] = float(np.degrees(np.sqrt(variance.mean())))
        result["nees_of_yaw"] = float((yaw**2 / variance).mean())
    return result
