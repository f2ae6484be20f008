"""The paper's simulation with the bearing errors of real links."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.table1.pose_noise import BelievedPoses, RadioNoiseConfig, poses_from_radio
from mulan.evaluation.table1.recorded_bearings import RecordedBearing, draw
from mulan.evaluation.table1.sources import Progress, SharedPhotographs, TeamSource
from mulan.evaluation.table1.team import Split, Team
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder


@dataclass(frozen=True)
class RealRadioSource(TeamSource):
    """Alpha exact, beta from a range and the bearing of a recorded link an image.

    Each image is given the error one link's bearing had, and believes it as far as that bearing said: some
    links leave two far directions open, so a camera stands where its likeliest one puts it.

    Attributes:
        images: The set at its true poses.
        links: Bearings to draw from.
        split: Who takes which photograph.
        radio: The other errors; its ``sigma_aoa_deg`` is not used.
    """

    images: PosedImageSet
    links: Sequence[RecordedBearing]
    split: Split = Split.AZIMUTH
    radio: RadioNoiseConfig = field(default_factory=RadioNoiseConfig)

    def team(self, seed: int, run: RunFolder, progress: Progress) -> Team:  # noqa: ARG002
        """See :class:`TeamSource`."""
        rng = np.random.default_rng([seed, 2])

        def believe(T: Float[NDArray, "n 4 4"], observer_m: Float[NDArray, "n 3"]) -> BelievedPoses:
            drawn = draw(self.links, len(T), rng)
            error_rad = np.array([link.error_rad for link in drawn])
            sigma_rad = np.array([link.sigma_rad for link in drawn])
            return poses_from_radio(T, observer_m, error_rad, sigma_rad, self.radio, rng, likeliest=True)

        return SharedPhotographs(self.images, self.split).team(rng, believe)
