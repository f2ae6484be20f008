"""What can be wrong with all that one robot measures, and when it is called so."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np


class Lie(StrEnum):
    """What is wrong with what a robot's radios report."""

    BEARINGS_TURNED = "bearings turned"
    """All bearings by the robot turned by one angle about the vertical."""
    BEARINGS_WRONG = "bearings wrong"
    """Most bearings by the robot point anywhere."""
    RANGES_BIASED = "ranges biased"
    """All ranges of the robot too long or too short by one length."""
    RANGES_WRONG = "ranges wrong"
    """Most ranges of the robot are of any length."""


@dataclass(frozen=True)
class Suspect:
    """A robot whose measurements contradict the rest of the team.

    Attributes:
        robot: Name.
        lie: What is wrong.
        evidence_nats: How much likelier all measurements are if it is so (logarithm of the ratio).
        amount: Angle [rad] of a turn, length [m] of a bias; None where there is no single one.
        measurements: How many were set aside because of it.
        alternatives: Robots that would explain it as well were they the suspect.
    """

    robot: str
    lie: Lie
    evidence_nats: float
    amount: float | None
    measurements: int
    alternatives: tuple[str, ...] = ()

    def sentence(self) -> str:
        """What is wrong and how sure that is, without the name."""
        how_much = ""
        if self.amount is not None:
            is_turn = self.lie is Lie.BEARINGS_TURNED
            how_much = f" by {np.degrees(self.amount):.0f}°" if is_turn else f" by {self.amount:.2f} m"
        return f"{self.lie}{how_much}, {self.measurements} set aside (evidence {self.evidence_nats:.0f} nats)"


@dataclass(frozen=True)
class TrustConfig:
    """When a robot's measurements are set aside as a whole."""

    check: bool = True
    """Look for robots whose measurements contradict the rest of the team."""
    least_evidence_nats: float = 12.0
    """How much likelier (logarithm) all measurements must be if the robot is wrong."""
    smallest_turn_deg: float = 8.0
    """Bearings turned less than this are not called wrong."""
    smallest_bias_m: float = 0.3
    """Ranges off by less than this are not called wrong."""
