"""Photographs with camera poses: what localization hands to reconstruction."""

from dataclasses import dataclass
from pathlib import Path

from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera


@dataclass(frozen=True)
class PosedImage:
    """One photograph file and where its camera was.

    Attributes:
        path: The image file.
        camera: Intrinsics at the file's own resolution.
        T_world_camera: Camera pose (OpenGL axes).
        pose_covariance: 6x6, right perturbation of T_world_camera (rotation rad, translation m);
            None = exact.
        robot_id: Robot that took it, if known.
        timestamp_s: When, on that robot's clock, if known.
    """

    path: Path
    camera: PinholeCamera
    T_world_camera: Float[NDArray, "4 4"]
    pose_covariance: Float[NDArray, "6 6"] | None = None
    robot_id: str | None = None
    timestamp_s: float | None = None


@dataclass(frozen=True)
class PosedImageSet:
    """Photographs to learn from and photographs to test on.

    Attributes:
        train: Seen by the trainer.
        test: Held out.
        source: File or folder they were read from, for messages.
        joint_pose_covariance: Of all images of ``train`` that have a covariance, in their order, where their
            errors are correlated; None = independent.
    """

    train: tuple[PosedImage, ...]
    test: tuple[PosedImage, ...]
    source: Path
    joint_pose_covariance: Float[NDArray, "m m"] | None = None
