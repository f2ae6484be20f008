"""Where a team's photographs and poses come from: one protocol of the table each."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.table1.pose_noise import (
    BelievedPoses,
    RadioNoiseConfig,
    RigidNoiseConfig,
    exact_poses,
    poses_from_radio,
    rigidly_displaced_poses,
)
from mulan.evaluation.table1.team import ALPHA, Split, Team, share_photographs
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder

Progress = Callable[[float, float, str], None]
"""Done, total, a few words."""

SPREAD_DEG = (1.0, 15.0)


class Noise(Enum):
    """What is wrong with the second robot's poses."""

    EQUAL = "equal"
    """Each image has a range and a bearing of its own, all equally good."""
    SPREAD = "spread"
    """The same, but the standard deviation of each bearing is between 1° and 15°, and known."""
    RIGID = "rigid"
    """One error common to all images: the frame of the whole robot is displaced and turned."""
    PERFECT = "perfect"
    """Nothing, but the covariance is that of ``equal``."""


class TeamSource(ABC):
    """Makes the team of one seed."""

    @abstractmethod
    def team(self, seed: int, run: RunFolder, progress: Progress) -> Team:
        """Photographs with true and believed poses.

        Args:
            seed: Source of all randomness.
            run: Folder of this seed, for files the protocol needs.
            progress: Follows what takes long.
        """


@dataclass(frozen=True)
class SharedPhotographs:
    """A posed image set dealt to two robots, of which alpha knows its poses exactly.

    Attributes:
        images: The set at its true poses.
        split: Who takes which photograph.
    """

    images: PosedImageSet
    split: Split

    def team(
        self,
        rng: np.random.Generator,
        believe: Callable[[Float[NDArray, "n 4 4"], Float[NDArray, "n 3"]], BelievedPoses],
    ) -> Team:
        """Deal, and let beta believe what ``believe`` makes of its true poses and of where it was heard from.

        Alpha hears all of them from its first photograph, whose pose is the world's in the paper.
        """
        alpha, beta = share_photographs(self.images, self.split, rng)
        T = np.stack([image.T_world_camera for image in beta])
        poses = believe(T, np.tile(alpha[0].T_world_camera[:3, 3], (len(T), 1)))
        believed = tuple(
            replace(image, T_world_camera=T, pose_covariance=covariance)
            for image, T, covariance in zip(beta, poses.T_world_camera, poses.covariance, strict=True)
        )
        images = self.images
        return Team(
            PosedImageSet((*alpha, *beta), images.test, images.source),
            PosedImageSet((*alpha, *believed), images.test, images.source, poses.joint_covariance),
            ALPHA,
        )


@dataclass(frozen=True)
class PaperSource(TeamSource):
    """The paper's simulation: alpha exact, beta from a range and an angle of arrival an image.

    Attributes:
        images: The set at its true poses.
        split: Who takes which photograph.
        noise: What is wrong with beta's poses.
        radio: How much, but for rigid noise.
        rigid: How much, for rigid noise.
    """

    images: PosedImageSet
    split: Split = Split.AZIMUTH
    noise: Noise = Noise.EQUAL
    radio: RadioNoiseConfig = field(default_factory=RadioNoiseConfig)
    rigid: RigidNoiseConfig = field(default_factory=RigidNoiseConfig)

    def team(self, seed: int, run: RunFolder, progress: Progress) -> Team:  # noqa: ARG002
        """See :class:`TeamSource`."""
        rng = np.random.default_rng([seed, 1])

        def believe(T: Float[NDArray, "n 4 4"], observer_m: Float[NDArray, "n 3"]) -> BelievedPoses:
            if self.noise is Noise.RIGID:
                return rigidly_displaced_poses(T, self.rigid, rng)
            n = len(T)
            spread = self.noise is Noise.SPREAD
            sigma_deg = rng.uniform(*SPREAD_DEG, n) if spread else np.full(n, self.radio.sigma_aoa_deg)
            sigma_rad = np.radians(sigma_deg)
            noisy = poses_from_radio(T, observer_m, rng.normal(0, sigma_rad), sigma_rad, self.radio, rng)
            return exact_poses(T, noisy.covariance) if self.noise is Noise.PERFECT else noisy

        return SharedPhotographs(self.images, self.split).team(rng, believe)
