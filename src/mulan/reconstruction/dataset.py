"""All pixels of a set of photographs as tensors, ready to be drawn at random as rays."""

import hashlib
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.geometry.camera import PinholeCamera
from mulan.radiance.engine import RayBatch, Rendering
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.kernels.ray_gather import PixelTable, gather_rays
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.sub_pixels import Renders, random_diagonals, render_pixels, spread_directions


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
        coverage = [image.alpha for image in self.images if image.alpha is not None]
        # random backgrounds need it of every pixel
        self._opacity = (
            torch.from_numpy(np.concatenate([alpha.reshape(-1) for alpha in coverage]))
            if len(coverage) == len(self.images)
            else None
        )
        maps = weight_maps or [torch.ones(h, w) for h, w in sizes]
        self.weights = torch.cat([m.reshape(-1).float() for m in maps])
        poses = np.stack([image.T_world_camera for image in self.images])
        self.T_world_camera = torch.from_numpy(poses).float()
        self._focal_px = torch.tensor([[image.camera.fx, image.camera.fy] for image in self.images])
        self._directions, table_start = _direction_tables([image.camera for image in self.images])
        # added to a global pixel number this gives the row of its direction
        self._direction_shift = table_start - self._first_pixel[:-1]
        # pixels of weight zero are never drawn
        self._drawable = (self.weights > 0).nonzero()[:, 0]
        self._every_pixel_drawable = len(self._drawable) == len(self.weights)
        self._last_table: PixelTable | None = None

    def __len__(self) -> int:
        """Number of images."""
        return len(self.images)

    def move_to(self, device: torch.device) -> None:
        """Keep the pixels, and so make the rays, on another device."""
        for name in ("_image_of_pixel", "_colour", "weights", "T_world_camera", "_directions", "_drawable"):
            setattr(self, name, getattr(self, name).to(device))
        self._direction_shift, self._focal_px = self._direction_shift.to(device), self._focal_px.to(device)
        self._opacity = None if self._opacity is None else self._opacity.to(device)

    @property
    def drawable_pixels(self) -> int:
        """Pixels of positive weight."""
        return len(self._drawable)

    def fingerprint(self) -> str:
        """Short digest of colours, weights, poses and lenses: two sets that differ in any differ in it."""
        digest = hashlib.sha256()
        for tensor in (self._colour, self.weights, self.T_world_camera, self._directions):
            digest.update(tensor.contiguous().cpu().numpy().tobytes())
        return digest.hexdigest()[:16]

    def sample(self, rays: int, generator: torch.Generator) -> RayBatch:
        """Pixels drawn uniformly, with replacement, among those of positive weight."""
        pixel = torch.randint(len(self._drawable), (rays,), generator=generator).to(self._drawable.device)
        return self.rays(pixel if self._every_pixel_drawable else self._drawable[pixel])

    def sample_pairs(self, rays: int, generator: torch.Generator) -> RayBatch:
        """Half as many pixels as rays: each is two rays on one of its diagonals, judged by their mean."""
        one = self.sample(max(rays // 2, 1), generator)
        offset_px = random_diagonals(len(one.weights), generator).to(one.origins.device)
        R, focal_px = self.T_world_camera[one.image_index, :3, :3], self._focal_px[one.image_index]
        return RayBatch(
            origins=one.origins.repeat_interleave(2, 0),
            directions=spread_directions(one.directions, R, focal_px, offset_px),
            colours=one.colours.repeat_interleave(2, 0),
            weights=one.weights.repeat_interleave(2),
            image_index=one.image_index.repeat_interleave(2),
            opacity=None if one.opacity is None else one.opacity.repeat_interleave(2),
            rays_a_pixel=2,
        )

    def rays(self, pixel: Int[Tensor, "r"]) -> RayBatch:
        """Rays of pixels numbered through all images, row by row."""
        in_main_memory = self._colour.device.type == "cpu"
        return gather_rays(self._table(), pixel, find_native_library()[0] if in_main_memory else None)

    def _table(self) -> PixelTable:
        # poses and weights may have been replaced since the last batch
        last = self._last_table
        if last and last.T_world_camera is self.T_world_camera and last.weights is self.weights:
            return last
        parts = self._colour, self.weights, self._image_of_pixel, self._directions, self._direction_shift
        self._last_table = PixelTable(*parts, self.T_world_camera.contiguous(), self._opacity)
        return self._last_table

    def image_rays(self, image: int) -> RayBatch:
        """Every ray of one image, row by row."""
        first, end = (int(self._first_pixel[i]) for i in (image, image + 1))
        return self.rays(torch.arange(first, end, device=self._drawable.device))

    def render(self, engine: Renders, image: int, sub_pixels: int = 1) -> Rendering:
        """What the field shows at one image's pose, row by row; see :func:`render_pixels`."""
        rays = self.image_rays(image)
        R, focal_px = self.T_world_camera[image, :3, :3], self._focal_px[image]
        pixels = len(rays.weights)
        lens = R.expand(pixels, 3, 3), focal_px.expand(pixels, 2)
        return render_pixels(engine, rays.origins, rays.directions, *lens, sub_pixels)


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
