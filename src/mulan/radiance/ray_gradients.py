"""Gradients to rays, and what they mean for the poses of the cameras the rays start from."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.radiance.kernels.native_buffers import address
from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import NativePoses


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
    poses, out, _keep = native_poses(image_index, R_world_camera)
    arrays = [x.contiguous() for x in (directions, gradients.origins, gradients.directions)]
    shape = (len(image_index), 3)
    check(library.functions.mulan_pose_gradients(shape[0], *(address(x, shape) for x in arrays), poses))
    return out


def native_poses(
    image_index: Int[Tensor, "r"], R_world_camera: Float[Tensor, "images 3 3"]
) -> tuple[NativePoses, Float[Tensor, "images 6"], tuple]:
    """Poses for a call, the gradient it will fill, and the arrays that must outlive it."""
    index, R = image_index.long().contiguous(), R_world_camera.contiguous()
    out = torch.zeros(len(R), 6)
    poses = NativePoses(
        len(R), address(index, (len(index),), torch.int64), address(R, (len(R), 3, 3)), address(out)
    )
    return poses, out, (index, R)
