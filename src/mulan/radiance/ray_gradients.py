"""Gradients to rays, and what they mean for the poses of the cameras the rays start from."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.kernels.native_buffers import address
from mulan.radiance.kernels.native_library import NativeLibrary, check


@dataclass(frozen=True)
class RayGradients:
    """Gradient to rays, at fixed distances of the samples.

    Attributes:
        origins: To the origins [1/m].
        directions: To the directions, whose three numbers count as independent.
    """

    origins: Float[Tensor, "r 3"]
    directions: Float[Tensor, "r 3"]


def pose_gradients(
    library: NativeLibrary,
    gradients: RayGradients,
    directions: Float[Tensor, "r 3"],
    image_index: Int[Tensor, "r"],
    R_world_camera: Float[Tensor, "images 3 3"],
) -> Float[Tensor, "images 6"]:
    """Gradient to a right perturbation (rotation rad, translation m) of each image's camera pose.

    With ``T_world_camera exp(xi)``, xi = (w, v), the image's ray origins move by ``R v`` and its ray
    directions turn by ``R w``. The sum is taken in the order of the rays.

    Raises:
        ValueError: An image index is out of range, or arrays do not belong together.
    """
    out = torch.zeros(len(R_world_camera), 6)
    arrays = [directions, gradients.origins, gradients.directions, image_index.long(), R_world_camera]
    d, to_origins, to_directions, index, R = (x.contiguous() for x in arrays)
    if tuple(index.shape) != (len(d),):
        raise ValueError(f"{len(d)} rays need an image index each, not {tuple(index.shape)}")
    check(
        library.functions.mulan_pose_gradients(
            len(d),
            *(address(x, (len(d), 3)) for x in (d, to_origins, to_directions)),
            address(index),
            len(R),
            address(R, (len(R), 3, 3)),
            address(out),
        )
    )
    return out
