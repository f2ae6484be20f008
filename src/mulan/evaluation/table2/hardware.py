"""The hardware experiment, simulated: whose own track is by motion capture, whose by drifting odometry."""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from mulan.evaluation.table1.loop import LoopSource
from mulan.geometry import se3
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.types import Mission, RobotLog
from mulan.simulation.odometry import OdometryNoiseConfig, simulate_odometry

MOTION_CAPTURE = OdometryNoiseConfig(0.01, 0.001, 0.005)
"""A hundredth of the drift: below a millimetre and a hundredth of a degree over a tour."""


class Drift(Enum):
    """Whose odometry drifts."""

    BOTH = "both"
    """No robot is exact; the world is the first one's start frame."""
    SECOND = "second"
    """The first robot's own track is by motion capture."""

    @property
    def motion_captured(self) -> int:
        """Robots, from the first on, whose own track is by motion capture."""
        return 0 if self is Drift.BOTH else 1


@dataclass(frozen=True)
class HardwareSource(LoopSource):
    """The same mission, but for the first robots' own tracks.

    Photographs, radio and the drift of the other robots do not depend on ``motion_captured``.

    Attributes:
        motion_captured: Robots, from the first on, whose own track is by motion capture; only the radio tells
            where such a robot is relative to the others.
    """

    motion_captured: int = 0

    def mission(self, seed: int) -> Mission:
        """What the robots record."""
        mission = super().mission(seed)
        rng = np.random.default_rng([seed, 4])
        captured = [_by_motion_capture(robot, rng) for robot in mission.robots[: self.motion_captured]]
        return replace(mission, robots=(*captured, *mission.robots[self.motion_captured :]))

    def _made_from(self, seed: int) -> str:
        return f"{super()._made_from(seed)}-{self.motion_captured}"


def _by_motion_capture(robot: RobotLog, rng: np.random.Generator) -> RobotLog:
    truth = robot.ground_truth
    assert truth is not None  # simulated robots know
    return replace(robot, odometry=simulate_odometry(truth.time_s, truth.T_world_body, MOTION_CAPTURE, rng))


def at_own_odometry(mission: Mission, images: PosedImageSet) -> PosedImageSet:
    """A mission's photographs at each robot's own odometry, in its own start frame, taken as exact.

    Args:
        mission: What was recorded.
        images: The photographs, robot by robot and in order of time.
    """
    T = [
        se3.interpolate(robot.odometry.time_s, robot.odometry.T_odom_body, robot.photo_time_s)
        @ robot.T_body_camera
        for robot in mission.robots
    ]
    moved = tuple(
        replace(image, T_world_camera=pose, pose_covariance=None)
        for image, pose in zip(images.train, np.concatenate(T), strict=True)
    )
    return replace(images, train=moved, joint_pose_covariance=None)
