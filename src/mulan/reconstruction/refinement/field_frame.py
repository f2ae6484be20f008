"""Where the field that poses are compared with lies in the world, and how large it is there."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry import se3


@dataclass(frozen=True)
class FieldFrame:
    """Similarity from a field to the world; photographs cannot tell it, only what is known of the poses.

    Attributes:
        T_world_field: Its rigid part.
        metres_per_unit: How long the field's unit is in the world.
    """

    T_world_field: Float[NDArray, "4 4"] = field(default_factory=lambda: np.eye(4))
    metres_per_unit: float = 1.0

    def to_field(self, T_world_camera: Float[NDArray, "*b 4 4"]) -> Float[NDArray, "*b 4 4"]:
        """Poses as the field has them, positions in its units."""
        T = se3.inverse(self.T_world_field) @ T_world_camera
        return se3.from_parts(T[..., :3, :3], T[..., :3, 3] / self.metres_per_unit)

    def to_world(self, T_field_camera: Float[NDArray, "*b 4 4"]) -> Float[NDArray, "*b 4 4"]:
        """Inverse of :meth:`to_field`."""
        scaled = se3.from_parts(
            T_field_camera[..., :3, :3], T_field_camera[..., :3, 3] * self.metres_per_unit
        )
        return self.T_world_field @ scaled

    def moved(self, shift: Float[NDArray, "7"]) -> "FieldFrame":
        """A twist of the world (rotation rad, translation m) and a change of the logarithm of the scale."""
        return FieldFrame(
            se3.exp(shift[:6]) @ self.T_world_field, self.metres_per_unit * float(np.exp(shift[6]))
        )

    def carries(self, T_world_camera: Float[NDArray, "n 4 4"]) -> Float[NDArray, "n 6 7"]:
        """Right perturbation of cameras that go along with the frame, by its shift, to first order.

        A pose that goes along with the field changes nothing in its picture.
        """
        R, away = T_world_camera[:, :3, :3], T_world_camera[:, :3, 3] - self.T_world_field[:3, 3]
        outward = np.zeros((len(R), 6, 1))
        outward[:, 3:, 0] = np.einsum("nij,ni->nj", R, away)
        return np.concatenate([se3.adjoint(se3.inverse(T_world_camera)), outward], -1)
