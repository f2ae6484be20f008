"""What lies between two antennas: anything that gives a channel, and the mirrors of an empty room."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Complex, Float
from numpy.typing import NDArray

from mulan.simulation.image_sources import RoomConfig, image_sources

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0


@runtime_checkable
class Propagation(Protocol):
    """Surroundings of a radio link."""

    def channel(
        self,
        transmitter_world_m: Float[NDArray, "n 3"],
        receiver_world_m: Float[NDArray, "n 3"],
        subcarrier_hz: Float[NDArray, "s"],
    ) -> Complex[NDArray, "n s"]:
        """Noise-free channel, row by row.

        The direct path over a distance d alone gives ``exp(-j 2π f d / c) / d``; what is dark gives zero.
        """
        ...


@dataclass(frozen=True)
class Mirrors:
    """The built-in radio: every wall of a box is a mirror.

    Attributes:
        room: The box, or None for free space.
    """

    room: RoomConfig | None

    def channel(
        self,
        transmitter_world_m: Float[NDArray, "n 3"],
        receiver_world_m: Float[NDArray, "n 3"],
        subcarrier_hz: Float[NDArray, "s"],
    ) -> Complex[NDArray, "n s"]:
        """See :func:`multipath_channel`."""
        return multipath_channel(transmitter_world_m, receiver_world_m, subcarrier_hz, self.room)


def multipath_channel(
    transmitter_world_m: Float[NDArray, "n 3"],
    receiver_world_m: Float[NDArray, "n 3"],
    subcarrier_hz: Float[NDArray, "s"],
    room: RoomConfig | None,
) -> Complex[NDArray, "n s"]:
    """Noise-free channel ``Σ_paths (g / d) exp(-j 2π f d / c)`` with exact spherical distances d.

    This is the paper's channel equation written out; the sign means that phase falls as distance grows (the
    printed sign is discussed in docs/readings, row 5).
    """
    images, amplitude = image_sources(transmitter_world_m, room)
    distance_m = np.linalg.norm(images - receiver_world_m[:, None, :], axis=-1)
    wavenumber = 2 * np.pi * subcarrier_hz / SPEED_OF_LIGHT_M_PER_S
    paths = (amplitude / distance_m)[:, :, None] * np.exp(-1j * distance_m[:, :, None] * wavenumber)
    return paths.sum(1)
