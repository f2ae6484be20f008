"""Multipath in a box: every wall acts as a mirror (Allen & Berkley, J. Acoust. Soc. Am. 65, 1979)."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.errors import InputError


@dataclass(frozen=True)
class RoomConfig:
    """An empty box-shaped room that reflects radio."""

    min_corner_m: tuple[float, float, float] = (-3.5, -3.0, 0.0)
    """Lowest corner of the room in the world frame, metres."""
    max_corner_m: tuple[float, float, float] = (3.5, 3.0, 2.8)
    """Highest corner of the room in the world frame, metres."""
    wall_reflection: float = 0.35
    """Amplitude that survives one bounce."""
    max_order: int = 1
    """Most bounces a path may make."""

    def __post_init__(self) -> None:
        """Refuse an empty box.

        Raises:
            InputError: A corner is not below the other one.
        """
        if not all(low < high for low, high in zip(self.min_corner_m, self.max_corner_m, strict=True)):
            raise InputError(
                "room", "min_corner_m", "is not below max_corner_m on every axis", "swap or widen the corners"
            )


def image_sources(
    source_world_m: Float[NDArray, "n 3"], room: RoomConfig | None
) -> tuple[Float[NDArray, "n paths 3"], Float[NDArray, "paths"]]:
    """The source and its mirror images.

    Image i on one axis lies ``i`` room lengths away, mirrored where i is odd, after ``|i|`` bounces.

    Args:
        source_world_m: Positions of the transmitter.
        room: The box, or None for free space.

    Returns:
        Image positions, direct path first, and the amplitude of each path before spreading.
    """
    if room is None:
        return source_world_m[:, None, :], np.ones(1)
    low, high = np.array(room.min_corner_m, dtype=float), np.array(room.max_corner_m, dtype=float)
    span = range(-room.max_order, room.max_order + 1)
    index = [i for i in product(span, repeat=3) if sum(map(abs, i)) <= room.max_order]
    index.sort(key=lambda i: sum(map(abs, i)))
    shift = np.array(index)
    inside = (source_world_m - low)[:, None, :]
    mirrored = np.where(shift % 2 == 1, (high - low) - inside, inside)
    bounces = np.abs(shift).sum(1)
    return low + shift * (high - low) + mirrored, room.wall_reflection ** bounces.astype(float)
