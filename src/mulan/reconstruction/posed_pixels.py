"""Pixels of posed photographs, ready to be drawn at random as rays, wherever they are kept."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from mulan.geometry.camera import PinholeCamera
from mulan.radiance.engine import RayBatch, Rendering
from mulan.radiance.split_step import BatchPart
from mulan.reconstruction.captured_image import CapturedImage, check_posed
from mulan.reconstruction.sub_pixels import Renders, random_diagonals, render_pixels, spread_directions


class PosedPixels(ABC):
    """Photographs as rays; pixels are numbered through all images, row by row.

    Attributes:
        images: The photographs.
        T_world_camera: Camera poses, float32; replace them to learn from corrected poses.
        image_gain: How much brighter each photograph shows red, green and blue than the field is to; colours
            of its rays are divided by that. None = not at all.
        rests: Photographs nothing is learnt from for now: their pixels are drawn, but have no weight.
    """

    def __init__(self, images: Sequence[CapturedImage]) -> None:
        """Place the pixels of ``images``.

        Raises:
            ValueError: There is no image.
            InputError: A pose, covariance or lens holds NaN or infinity.
        """
        if not images:
            raise ValueError("no images")
        self.images = tuple(images)
        for image in self.images:
            check_posed(image.posed, image.camera)
        counts = torch.tensor([image.colour.shape[0] * image.colour.shape[1] for image in self.images])
        self._first_pixel = torch.cat([torch.zeros(1, dtype=torch.long), counts.cumsum(0)])
        poses = np.stack([image.T_world_camera for image in self.images])
        self.T_world_camera = torch.from_numpy(poses).float()
        self._focal_px = torch.tensor([[image.camera.fx, image.camera.fy] for image in self.images])
        self._device = torch.device("cpu")
        self.image_gain: Float[Tensor, "n 3"] | None = None
        self.rests: Bool[Tensor, "n"] | None = None

    def __len__(self) -> int:
        """Number of images."""
        return len(self.images)

    @abstractmethod
    def move_to(self, device: torch.device) -> None:
        """Make the rays on another device."""

    @property
    @abstractmethod
    def drawable_pixels(self) -> int:
        """Pixels of positive weight."""

    @abstractmethod
    def fingerprint(self) -> str:
        """Short digest of colours, weights, poses and lenses: two sets that differ in any differ in it."""

    def rays(self, pixel: Int[Tensor, "r"]) -> RayBatch:
        """Rays of pixels; what the object was cut out of, white, has no gain."""
        batch = self._rays(pixel)
        if self.image_gain is None:
            return batch
        white = 0.0 if batch.opacity is None else (1 - batch.opacity)[:, None]
        return replace(batch, colours=(batch.colours - white) / self.image_gain[batch.image_index] + white)

    @abstractmethod
    def _rays(self, pixel: Int[Tensor, "r"]) -> RayBatch:
        """Rays of pixels, their colours as photographed."""

    @abstractmethod
    def _drawn(self, number: Int[Tensor, "r"]) -> Int[Tensor, "r"]:
        """Pixels by their number among those of positive weight."""

    def sample(self, rays: int, generator: torch.Generator, part: BatchPart | None = None) -> RayBatch:
        """Pixels drawn uniformly, with replacement, among those of positive weight; of these, a part."""
        number = torch.randint(self.drawable_pixels, (rays,), generator=generator)
        number = number if part is None else part.of(number)
        batch = self.rays(self._drawn(number.to(self._device)))
        if self.rests is None:
            return batch
        return replace(batch, weights=batch.weights * ~self.rests[batch.image_index])

    def sample_pairs(self, rays: int, generator: torch.Generator, part: BatchPart | None = None) -> RayBatch:
        """Half as many pixels as rays: each is two rays on one of its diagonals, judged by their mean."""
        pixels = max(rays // 2, 1)
        part = BatchPart.whole(pixels) if part is None else part.in_pixels(2)
        one = self.sample(pixels, generator, part)
        offset_px = part.of(random_diagonals(pixels, generator)).to(one.origins.device)
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

    def rays_at(self, pixel: Int[Tensor, "r"], T_world_camera: Float[Tensor, "n 4 4"]) -> RayBatch:
        """Rays of pixels, were the cameras elsewhere."""
        own, self.T_world_camera = self.T_world_camera, T_world_camera
        try:
            return self.rays(pixel)
        finally:
            self.T_world_camera = own

    def first_pixel(self, image: int) -> int:
        """Number of an image's upper left pixel."""
        return int(self._first_pixel[image])

    def image_rays(self, image: int) -> RayBatch:
        """Every ray of one image, row by row."""
        first, end = (int(self._first_pixel[i]) for i in (image, image + 1))
        return self.rays(torch.arange(first, end, device=self._device))

    def render(self, engine: Renders, image: int, sub_pixels: int = 1) -> Rendering:
        """What the field shows at one image's pose, row by row; see :func:`render_pixels`."""
        rays = self.image_rays(image)
        R, focal_px = self.T_world_camera[image, :3, :3], self._focal_px[image]
        pixels = len(rays.weights)
        lens = R.expand(pixels, 3, 3), focal_px.expand(pixels, 2)
        return render_pixels(engine, rays.origins, rays.directions, *lens, sub_pixels)


def first_directions(cameras: Sequence[PinholeCamera]) -> tuple[list[PinholeCamera], Int[Tensor, "images"]]:
    """The distinct cameras, and where each image's directions begin when theirs stand one after another."""
    start: dict[PinholeCamera, int] = {}
    rows = 0
    for camera in cameras:
        if camera not in start:
            start[camera] = rows
            rows += camera.width * camera.height
    return list(start), torch.tensor([start[camera] for camera in cameras])
