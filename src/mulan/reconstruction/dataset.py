"""All pixels of a set of photographs as tensors, ready to be drawn at random as rays."""

import hashlib
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mulan.errors import InputError
from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.kernels.ray_gather import PixelTable, gather_rays
from mulan.reconstruction.captured_image import CapturedImage
from mulan.reconstruction.posed_pixels import PosedPixels, first_directions


class ImageTensors(PosedPixels):
    """Photographs flattened pixel by pixel; colours stay 8-bit, directions are kept once a camera.

    Attributes:
        images: The photographs.
        T_world_camera: Camera poses, float32; replace them to learn from corrected poses.
        image_gain: See :class:`PosedPixels`.
        weights: Trust in each pixel, [pixels].
    """

    def __init__(
        self, images: Sequence[CapturedImage], weight_maps: Sequence[Float[Tensor, "_ _"]] | None = None
    ) -> None:
        """Gather the pixels of ``images``; a weight map each, or all ones.

        Raises:
            ValueError: There is no image, or a map's size is not its image's.
            InputError: A pose, covariance, lens or weight is not a finite number.
        """
        super().__init__(images)
        sizes = [image.colour.shape[:2] for image in self.images]
        maps = weight_maps or [torch.ones(h, w) for h, w in sizes]
        for image, weight_map in zip(self.images, maps, strict=True):
            check_weight_map(image, weight_map)
        counts = torch.tensor([h * w for h, w in sizes])
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
        self.weights = torch.cat([m.reshape(-1).float() for m in maps])
        cameras, table_start = first_directions([image.camera for image in self.images])
        tables = [torch.from_numpy(camera.pixel_directions().reshape(-1, 3)).float() for camera in cameras]
        self._directions = torch.cat(tables)
        # added to a global pixel number this gives the row of its direction
        self._direction_shift = table_start - self._first_pixel[:-1]
        # pixels of weight zero are never drawn
        self._drawable = (self.weights > 0).nonzero()[:, 0]
        self._every_pixel_drawable = len(self._drawable) == len(self.weights)
        self._last_table: PixelTable | None = None

    def move_to(self, device: torch.device) -> None:
        """See :class:`PosedPixels`; the pixels move too."""
        for name in ("_image_of_pixel", "_colour", "weights", "T_world_camera", "_directions", "_drawable"):
            setattr(self, name, getattr(self, name).to(device))
        self._direction_shift, self._focal_px = self._direction_shift.to(device), self._focal_px.to(device)
        self._opacity = None if self._opacity is None else self._opacity.to(device)
        self._device = device

    @property
    def drawable_pixels(self) -> int:
        """Pixels of positive weight."""
        return len(self._drawable)

    def fingerprint(self) -> str:
        """See :class:`PosedPixels`."""
        colours = hashlib.sha256()
        for image in self.images:
            colours.update(image.colour_and_alpha.data)
        colours.update(bytes([image.alpha is not None for image in self.images]))
        weights, directions = (
            hashlib.sha256(part.cpu().contiguous().numpy().tobytes()).hexdigest()
            for part in (self.weights, self._directions)
        )
        return fingerprint_of(colours.hexdigest(), weights, directions, self.T_world_camera)

    def _rays(self, pixel: Int[Tensor, "r"]) -> RayBatch:
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

    def _drawn(self, number: Int[Tensor, "r"]) -> Int[Tensor, "r"]:
        return number if self._every_pixel_drawable else self._drawable[number]


def check_weight_map(image: CapturedImage, weight_map: Float[Tensor, "h w"]) -> None:
    """Refuse weights that are of another size, negative or not finite.

    Raises:
        ValueError: The size is not the image's.
        InputError: A weight is negative, NaN or infinite; the sentence names the photograph.
    """
    if tuple(weight_map.shape) != tuple(image.colour.shape[:2]):
        raise ValueError("weight maps and images differ in size")
    if not (torch.isfinite(weight_map).all() and (weight_map >= 0).all()):
        raise InputError(
            image.posed.path, "weights", "are negative, NaN or infinite", "use another weighting"
        )


def fingerprint_of(
    colours: str, weights: str, directions: str, T_world_camera: Float[Tensor, "n 4 4"]
) -> str:
    """Digest of a set from the digests of its parts and its poses."""
    poses = T_world_camera.cpu().contiguous().numpy().tobytes()
    return hashlib.sha256(f"{colours} {weights} {directions} ".encode() + poses).hexdigest()[:16]
