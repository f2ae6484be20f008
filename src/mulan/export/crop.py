"""The part of the world that is exported."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.radiance.space import SceneSpace


@dataclass(frozen=True)
class Box:
    """A box along the world's axes.

    Attributes:
        low_m, high_m: Opposite corners.
    """

    low_m: Float[NDArray, "3"]
    high_m: Float[NDArray, "3"]

    def holds(self, points_m: Float[NDArray, "n 3"]) -> Bool[NDArray, "n"]:
        """Which points lie inside."""
        return np.all((points_m >= self.low_m) & (points_m <= self.high_m), axis=-1)


@dataclass(frozen=True)
class CropConfig:
    """The part of the world to export, along the axes of the first robot's start frame."""

    centre_m: tuple[float, float, float] | None = None
    """Middle of the box; the scene's own centre if not given."""
    size_m: tuple[float, float, float] | None = None
    """Its sides. If not given: all of a bounded scene, or as far from the centre as the cameras stand."""

    def box(self, space: SceneSpace) -> Box:
        """The box of a scene.

        Raises:
            InputError: A number is not finite, or a side not positive.
        """
        centre = np.array(space.centre_m if self.centre_m is None else self.centre_m, dtype=float)
        size = np.array((2 * space.radius_m,) * 3 if self.size_m is None else self.size_m, dtype=float)
        if not (np.isfinite(centre).all() and np.isfinite(size).all() and (size > 0).all()):
            raise InputError(
                "--crop", "centre and size", "are no box", "give three metres each, sides above zero"
            )
        return Box(centre - size / 2, centre + size / 2)

    @property
    def given(self) -> bool:
        """Whether anything was asked for."""
        return self.centre_m is not None or self.size_m is not None
