"""What a growing mission lets its team believe of where it is."""

from collections.abc import Sequence

from mulan.localization.accuracy import world_from_truth
from mulan.localization.localize import LocalizationConfig, localize_from_measurements
from mulan.localization.posed_images import localized_images
from mulan.localization.types import Localization
from mulan.mission.extract import extract_photos
from mulan.mission.posed_images import PosedImageSet
from mulan.mission.run_folder import RunFolder
from mulan.mission.types import Mission, RobotLog
from mulan.wireless.bearing import BearingConfig, estimate_bearings
from mulan.wireless.ranging import thin_ranges
from mulan.wireless.types import Bearing, Range


class TeamBelief:
    """Bearings and ranges of all legs so far; each leg's radio is worked on once.

    Attributes:
        bearings, ranges: Measurements so far.
    """

    def __init__(self, graph: LocalizationConfig, bearings: BearingConfig) -> None:
        self._graph, self._radio = graph, bearings
        self.bearings: list[Bearing] = []
        self.ranges: list[Range] = []

    def branch(self) -> "TeamBelief":
        """A copy that hears its own legs from here."""
        other = TeamBelief(self._graph, self._radio)
        other.bearings, other.ranges = list(self.bearings), list(self.ranges)
        return other

    def hear(self, leg: Sequence[RobotLog]) -> None:
        """Add what the radios of a leg say."""
        self.bearings += estimate_bearings(leg, self._radio)
        self.ranges += thin_ranges(leg, self._graph.ranging)

    def localize(self, mission: Mission) -> Localization:
        """Poses of all photographs in the anchor's start frame, with covariance; the truth is not read.

        Raises:
            InputError: No robot beside the anchor can be placed.
        """
        localization = localize_from_measurements(mission.robots, self.bearings, self.ranges, self._graph)
        localization.require_any_placed()
        return localization


def believed_images(mission: Mission, localization: Localization, run: RunFolder) -> PosedImageSet:
    """All photographs of the placed robots at their estimated poses, and the test views; files in the run."""
    files = extract_photos(mission, run)
    return localized_images(mission, localization, files, world_from_truth(mission), hold_out_every=0)
