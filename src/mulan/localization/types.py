"""Where every robot was, in one frame, and how well that is known."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.localization.information import Undetermined
from mulan.localization.lies import Suspect
from mulan.localization.odometry_correction import OdometryCorrection
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
class RelativePose:
    """One robot's body as another's sees it, with what the graph knows of both together.

    Attributes:
        robot, peer: Names.
        time_s: Instant on the robot's clock.
        peer_time_s: The same instant on the peer's clock.
        T_robot_peer: The peer's body pose in the robot's body frame.
        covariance: Of that pose (right perturbation; rotation rad, translation m). What both owe to the same
            measurements cancels, so it is not the sum of their covariances in the world.
    """

    robot: str
    peer: str
    time_s: float
    peer_time_s: float
    T_robot_peer: Float[NDArray, "4 4"]
    covariance: Float[NDArray, "6 6"]


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
        undetermined: Robots that could not be placed; they have no trajectory.
        suspects: Robots whose measurements were set aside as a whole, the surest first.
        relative_poses: Of every pair of placed robots, at instants spread over the mission, the last its end.
        odometry: What was learned about each robot's odometry.
        joint_covariance: Of the body poses at all photographs together, in the order of ``trajectories``;
            None if there are more than ``LocalizationConfig.most_joint_photographs``.
    """

    anchor: str
    trajectories: Mapping[str, PosedTrajectory]
    T_world_odom: Mapping[str, Float[NDArray, "4 4"]]
    bearings: tuple[Bearing, ...]
    bearing_inlier: Float[NDArray, "m"]
    ranges: tuple[Range, ...]
    cost: float
    undetermined: tuple[Undetermined, ...] = ()
    suspects: tuple[Suspect, ...] = ()
    relative_poses: tuple[RelativePose, ...] = ()
    odometry: Mapping[str, OdometryCorrection] = field(default_factory=dict)
    joint_covariance: Float[NDArray, "d d"] | None = None

    def require_any_placed(self) -> None:
        """Nothing to do if a robot beside the anchor was placed, or there is only the anchor.

        Raises:
            InputError: Says what the first undetermined robot lacks.
        """
        if len(self.trajectories) < 2 and self.undetermined:
            raise self.undetermined[0].error()

    def require_all_placed(self) -> None:
        """Nothing to do if every robot was placed.

        Raises:
            InputError: Says what the first undetermined robot lacks.
        """
        if self.undetermined:
            raise self.undetermined[0].error()
