"""Names of the radios of a simulated world."""

from enum import Enum


class RadioKind(Enum):
    """What carries radio from antenna to antenna."""

    MIRRORS = "mirrors"
    """Every wall of an empty box is a mirror of one strength; needs nothing."""
    SIONNA = "sionna"
    """Rays traced among all things of the scene and what they are made of; needs the extra 'sionna'."""
