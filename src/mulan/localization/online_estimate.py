"""What the online solver knows after an update."""

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3


@dataclass(frozen=True)
class OnlineEstimate:
    """Newest poses and their joint covariance.

    Attributes:
        names: Placed robots heard of lately, in the order of ``joint_covariance``.
        time_s: Newest keyframe of every placed robot, on its own clock.
        T_world_body: Its pose in the anchor's start frame.
        covariance: Marginal covariance of each pose (right perturbation; rotation rad, translation m); of a
            robot silent for long, as it was last known.
        joint_covariance: Over ``names``, six rows a robot.
        keys: Of the poses in ``joint_covariance``.
        waiting: Why each other robot has no place yet.
    """

    names: tuple[str, ...]
    time_s: Mapping[str, float]
    T_world_body: Mapping[str, Float[NDArray, "4 4"]]
    covariance: Mapping[str, Float[NDArray, "6 6"]]
    joint_covariance: Float[NDArray, "n n"]
    keys: tuple[int, ...]
    waiting: Mapping[str, str]

    def pair_covariance(self, first: str, second: str) -> Float[NDArray, "12 12"]:
        """Joint covariance of two robots' poses.

        Raises:
            ValueError: One of them is not in ``names``.
        """
        rows = np.concatenate([6 * self.names.index(name) + np.arange(6) for name in (first, second)])
        return self.joint_covariance[np.ix_(rows, rows)]

    def relative_covariance(self, observer: str, peer: str) -> Float[NDArray, "6 6"]:
        """Covariance of ``T_observer_peer`` (right perturbation of the peer): what the two must agree on."""
        T = se3.inverse(self.T_world_body[observer]) @ self.T_world_body[peer]
        J = np.concatenate([-gtsam.Pose3(T).inverse().AdjointMap(), np.eye(6)], axis=1)
        return J @ self.pair_covariance(observer, peer) @ J.T
