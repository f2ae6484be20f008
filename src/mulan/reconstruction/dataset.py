"""All pixels of a set of photographs as tensors, ready to be drawn at random as rays."""

import hashlib
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.geometry.camera import PinholeCamera
from mulan.radiance.engine import RayBatch
from mulan.radiance.split_step import BatchPart
from mulan.reconstruction.captured_image import CapturedImage


class ImageTensors:
    """Photographs flattened pixel by pixel; colours stay 8-bit, directions are kept once a camera.

    Attributes:
        images: The photographs.
        T_world_camera: Camera poses, float32; replace them to learn from corrected poses.
        weights: Trust in each pixel, [pixels].
    """

    def __init__(
        self, images: Sequence[CapturedImage], weight_maps: Sequence[Float[Tensor, "h w"]] | None = None
    ) -> None:
        """Gather the pixels of ``images``; a weight map each, or all ones.

        Raises:
            ValueError: There is no image, or a map's size is not its image's.
        """
        if not images:
            raise ValueError("no images")
        self.images = tuple(images)
        sizes = [image.colour.shape[:2] for image in self.images]
        if weight_maps is not None and [tuple(m.shape) for m in weight_maps] != [tuple(s) for s in sizes]:
            raise ValueError("weight maps and images differ in size")
        counts = torch.tensor([h * w for h, w in sizes])
        self._first_pixel = torch.cat([torch.zeros(1, dtype=torch.long), counts.cumsum(0)])
        self._image_of_pixel = torch.repeat_interleave(torch.arange(len(counts)), counts).to(torch.int32)
        self._colour = torch.from_numpy(
            np.concatenate([image.colour.reshape(-1, 3) for image in self.images])
        )
        maps = weight_maps or [torch.ones(h, w) for h, w in sizes]
        self.weights = torch.cat([m.reshape(-1).float() for m in maps])
        poses = np.stack([image.T_world_camera for image in self.images])
        self.T_world_camera = torch.from_numpy(poses).float()
        self._directions, table_start = _direction_tables([image.camera for image in self.images])
        # added to a global pixel number this gives the row of its direction
        self._direction_shift = table_start - self._first_pixel[:-1]
        # pixels of weight zero are never drawn
        self._drawable = (self.weights > 0).nonzero()[:, 0]
        self._every_pixel_drawable = len(self._drawable) == len(self.weights)

    def __len__(self) -> int:
        """Number of images."""
        return len(self.images)

    @property
    def drawable_pixels(self) -> int:
        """Pixels of positive weight."""
        return len(self._drawable)

    def fingerprint(self) -> str:
        """Short digest of colours, weights, poses and lenses: two sets that differ in any differ in it."""
        digest = hashlib.sha256()
        for tensor in (self._colour, self.weights, self.T_world_camera, self._directions):
            digest.update(tensor.contiguous().numpy().tobytes())
        return digest.hexdigest()[:16]

    def sample(self, rays: int, generator: torch.Generator, part: BatchPart | None = None) -> RayBatch:
        """Pixels drawn uniformly, with replacement, among those of positive weight; of these, a part."""
        pixel = torch.randint(len(self._drawable), (rays,), generator=generator)
        pixel = pixel if part is None else part.of(pixel)
        return self.rays(pixel if self._every_pixel_drawable else self._drawable[pixel])

    def rays(self, pixel: Int[Tensor, "r"]) -> RayBatch:
        """Rays of pixels numbered through all images, row by row."""
        image = self._image_of_pixel[pixel].long()
        camera_direction = self._directions[pixel + self._direction_shift[image]]
        T = self.T_world_camera[image]
        direction = (T[:, :3, :3] * camera_direction[:, None, :]).sum(-1)
        return RayBatch(
            origins=T[:, :3, 3],
            directions=torch.nn.functional.normalize(direction, dim=-1),
            colours=self._colour[pixel].float() / 255,
            weights=self.weights[pixel],
            image_index=image,
        )

    def image_rays(self, image: int) -> RayBatch:
        """Every ray of one image, row by row."""
        return self.rays(torch.arange(int(self._first_pixel[image]), int(self._first_pixel[image + 1])))


def _direction_tables(cameras: Sequence[PinholeCamera]) -> tuple[Float[Tensor, "n 3"], Int[Tensor, "images"]]:
    """Camera-frame directions of the distinct cameras one after another, and where each image's begin."""
    start: dict[PinholeCamera, int] = {}
    tables: list[Tensor] = []
    rows = 0
    for camera in cameras:
        if camera not in start:
            start[camera] = rows
            tables.append(torch.from_numpy(camera.pixel_directions().reshape(-1, 3)).float())
            rows += len(tables[-1])
    return torch.cat(tables), torch.tensor([start[camera] for camera in cameras])
