"""From pixels to rays: the readable torch reference, and the library's loop where there is one."""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int, Int32, UInt8
from torch import Tensor

from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_buffers import address
from mulan.radiance.kernels.native_library import NativeLibrary, check
from mulan.radiance.kernels.native_structures import NativePixels, NativeRayBatch


@dataclass(frozen=True)
class PixelTable:
    """The pixels of all photographs one after another.

    Attributes:
        colours: 8-bit colours.
        weights: Trust in each pixel.
        image: Which image each pixel is of.
        camera_directions: Camera-frame directions, once for each distinct camera.
        direction_shift: Pixel p of image i looks along row ``p + direction_shift[i]``.
        T_world_camera: Camera poses, float32.
        opacity: 8-bit coverage by the object, where it was cut out.
    """

    colours: UInt8[Tensor, "p 3"]
    weights: Float[Tensor, "p"]
    image: Int32[Tensor, "p"]
    camera_directions: Float[Tensor, "n 3"]
    direction_shift: Int[Tensor, "images"]
    T_world_camera: Float[Tensor, "images 4 4"]
    opacity: UInt8[Tensor, "p"] | None = None

    @cached_property
    def native(self) -> NativePixels:
        """The same as the library reads it.

        Raises:
            ValueError: A tensor is not contiguous in main memory, or of another shape or type.
        """
        pixels, images, rows = len(self.image), len(self.T_world_camera), len(self.camera_directions)
        return NativePixels(
            pixels,
            images,
            rows,
            address(self.colours, (pixels, 3), torch.uint8),
            None if self.opacity is None else address(self.opacity, (pixels,), torch.uint8),
            address(self.weights, (pixels,)),
            address(self.image, (pixels,), torch.int32),
            address(self.camera_directions, (rows, 3)),
            address(self.direction_shift, (images,), torch.int64),
            address(self.T_world_camera, (images, 4, 4)),
        )


def gather_rays_reference(table: PixelTable, pixel: Int[Tensor, "r"]) -> RayBatch:
    """Rays of pixels numbered through all images, row by row."""
    image = table.image[pixel].long()
    camera_direction = table.camera_directions[pixel + table.direction_shift[image]]
    T = table.T_world_camera[image]
    direction = (T[:, :3, :3] * camera_direction[:, None, :]).sum(-1)
    return RayBatch(
        origins=T[:, :3, 3],
        directions=torch.nn.functional.normalize(direction, dim=-1),
        colours=table.colours[pixel].float() / 255,
        weights=table.weights[pixel],
        image_index=image,
        opacity=None if table.opacity is None else table.opacity[pixel].float() / 255,
    )


def gather_rays(table: PixelTable, pixel: Int[Tensor, "r"], library: NativeLibrary | None) -> RayBatch:
    """As :func:`gather_rays_reference`, by the library if one is given.

    Raises:
        ValueError: A pixel is out of range (with the library).
    """
    if library is None:
        return gather_rays_reference(table, pixel)
    rays, pixel = len(pixel), pixel.contiguous()
    vectors, weights = torch.empty(3, rays, 3), torch.empty(rays)
    image_index = torch.empty(rays, dtype=torch.int64)
    origins, directions, colours = vectors.unbind(0)
    opacity = None if table.opacity is None else torch.empty(rays)
    out = NativeRayBatch(*(address(x) for x in (origins, directions, colours, weights, image_index)))
    out.opacity = None if opacity is None else address(opacity)
    check(library.functions.mulan_gather_rays(table.native, rays, address(pixel, (rays,), torch.int64), out))
    return RayBatch(origins, directions, colours, weights, image_index, opacity)
