"""Where every robot was, in one frame, and how well that is known."""

from collections.abc import Mapping
from dataclasses import dataclass

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.wireless.types import Bearing, Range


@dataclass(frozen=True)
class PosedTrajectory:
    """One robot's body poses at its photographs.

    Attributes:
        robot: Name.
        time_s: Exposure times on the robot's clock.
        T_world_body: Poses in the anchor robot's start frame.
        covariance: Marginal covariance of each pose (right perturbation; rotation rad, translation m).
    """

    robot: str
    time_s: Float[NDArray, "n"]
    T_world_body: Float[NDArray, "n 4 4"]
    covariance: Float[NDArray, "n 6 6"]


@dataclass(frozen=True)
class Localization:
    """Everything the factor graph concluded.

    Attributes:
        anchor: Robot whose start frame is the world.
        trajectories: By robot name.
        T_world_odom: Each robot's start frame in the world, as the graph first aligned it.
        bearings: Bearings used.
        bearing_inlier: Probability after optimisation that each bearing was right.
        ranges: Ranges used.
        cost: Final graph error.
    """

    anchor: str
    trajectories: Mapping[str, PosedTrajectory]
    T_world_odom: Mapping[str, Float[NDArray, "4 4"]]
    bearings: tuple[Bearing, ...]
    bearing_inlier: Float[NDArray, "m"]
    ranges: tuple[Range, ...]
    cost: float
