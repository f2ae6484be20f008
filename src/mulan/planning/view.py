"""A view that was taken or could be taken."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera


@dataclass(frozen=True, eq=False)
class View:
    """One camera at one place; two views are the same only if they are the same object.

    Attributes:
        camera: Intrinsics.
        T_world_camera: Where the camera is believed to be (OpenGL axes).
        covariance: How well that is known (6x6, right perturbation; rotation rad, translation m).
    """

    camera: PinholeCamera
    T_world_camera: Float[NDArray, "4 4"]
    covariance: Float[NDArray, "6 6"]

    @property
    def position_m(self) -> Float[NDArray, "3"]:
        """Where the camera stands in the world."""
        return self.T_world_camera[:3, 3]

    @property
    def sigma_m(self) -> float:
        """Standard deviation of the position, root of the mean over the axes."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:]) / 3))

    def taken_as_exact(self) -> "View":
        """The same view for somebody who trusts every pose."""
        return replace(self, covariance=np.zeros((6, 6)))
