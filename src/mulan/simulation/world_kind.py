"""Names of the built-in worlds."""

from enum import Enum


class WorldKind(Enum):
    """The worlds that need no file."""

    TABLETOP = "tabletop"
    """A table with a model rover, a globe, books and a mug, in the furnished room."""
    ROOM = "room"
    """A furnished room with a rover in its middle."""
    CORRIDOR = "corridor"
    """A corridor with two corners, 2 m wide."""
    YARD = "yard"
    """A yard with a fountain, a shed and trees, under an open sky."""
