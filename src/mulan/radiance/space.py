"""Where the field lives: a box of the world, or all of it squeezed into a box."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class SceneSpace:
    """Maps world points to the unit cube the hash grid covers.

    Bounded: the cube of half side ``radius_m`` about ``centre_m`` fills [0, 1]³; outside is empty.
    Unbounded: points within ``radius_m`` fill the inner half linearly and the rest is contracted into the
    outer half, ``x -> (2 - 1/|x|) x/|x|`` in the max norm, so the contracted world is exactly the cube
    [-2, 2]³ (mip-NeRF 360, eq. 10, with the max norm of MERF).

    Attributes:
        centre_m: Centre in world coordinates.
        radius_m: Half side of the (inner) cube.
        unbounded: Whether to contract.
    """

    centre_m: tuple[float, float, float]
    radius_m: float
    unbounded: bool

    def to_unit(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """World points to the unit cube."""
        x = (points - points.new_tensor(self.centre_m)) / self.radius_m
        if not self.unbounded:
            return x * 0.5 + 0.5
        norm = x.abs().amax(-1, keepdim=True).clamp_min(1e-9)
        contracted = torch.where(norm <= 1, x, (2 - 1 / norm) * (x / norm))
        return contracted * 0.25 + 0.5

    def to_world(self, unit: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Points of the unit cube back to the world (inverse of :meth:`to_unit`)."""
        if self.unbounded:
            contracted = unit * 4 - 2
            norm = contracted.abs().amax(-1, keepdim=True)
            # the cube's faces stand for infinity
            x = torch.where(norm <= 1, contracted, contracted / norm / (2 - norm).clamp_min(1e-6))
        else:
            x = unit * 2 - 1
        return x * self.radius_m + x.new_tensor(self.centre_m)
