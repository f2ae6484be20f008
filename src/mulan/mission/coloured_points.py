"""Points of a surface with colours."""

from dataclasses import dataclass

from jaxtyping import Float, UInt8
from numpy.typing import NDArray


@dataclass(frozen=True)
class ColouredPoints:
    """Points of a surface as a radiance field saw them.

    Attributes:
        position_m: World coordinates.
        colour: sRGB.
        variance: The field's variance of the colour at each point (colours in [0, 1]).
    """

    position_m: Float[NDArray, "n 3"]
    colour: UInt8[NDArray, "n 3"]
    variance: Float[NDArray, "n"]
