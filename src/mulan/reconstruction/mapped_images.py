"""Pixels of photographs that stay on disk, drawn at random like those in memory."""

import hashlib
import tempfile
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int
from numpy.typing import NDArray
from torch import Tensor

from mulan.radiance.engine import RayBatch
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.kernels.ray_gather import PixelTable, gather_rays
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.dataset import check_weight_map, fingerprint_of
from mulan.reconstruction.mapped_arrays import ArrayPlan, MappedArrays, map_arrays, write_arrays
from mulan.reconstruction.mapped_photographs import MappedPhotographs
from mulan.reconstruction.posed_pixels import PosedPixels, first_directions
from mulan.reconstruction.weights import Weighting

_PIECE = 2**20  # numbers looked at in one go


class MappedImages(PosedPixels):
    """What :class:`ImageTensors` is, with colours, weights and directions in memory-mapped files.

    The same photographs and weights give the same batches bit for bit, and the same fingerprint.
    """

    def __init__(
        self, photographs: MappedPhotographs, weighting: Weighting, space: SceneSpace, folder: Path
    ) -> None:
        """Compute weights and directions into files of the folder, unless they are there.

        Raises:
            InputError: A pose or weight is not finite, or the disk is full.
        """
        super().__init__(photographs.images)
        self._photographs, self._weighting, self._space = photographs, weighting, space
        # random backgrounds need the coverage of every pixel
        self._cut_out = all(image.alpha is not None for image in self.images)
        pixels = len(photographs.pixels)
        cameras, start = first_directions([image.camera for image in self.images])
        self._direction_shift = start - self._first_pixel[:-1]
        rows = sum(camera.width * camera.height for camera in cameras)
        parts = (camera.pixel_directions().reshape(-1, 3).astype(np.float32) for camera in cameras)
        plan = {"directions": ArrayPlan(np.float32, (rows, 3))}
        self._directions = _made(folder, "directions", f"{cameras}", plan, parts)

        posed = hashlib.sha256(photographs.digest.encode())
        for image in self.images:
            covariance = image.posed.pose_covariance
            posed.update(
                image.T_world_camera.tobytes() + (b"" if covariance is None else covariance.tobytes())
            )
        made_from = f"{posed.hexdigest()} {weighting!r} {space} {cameras}"
        plan = {"weights": ArrayPlan(np.float32, (pixels,))}
        self._weights = _made(folder, "weights", made_from, plan, self._weight_maps(folder))
        weights = self._weights.arrays["weights"]
        pieces = range(0, pixels, _PIECE)
        self._drawable_pixels = sum(int((weights[i : i + _PIECE] > 0).sum()) for i in pieces)
        self._drawable: NDArray | None = None
        if self._drawable_pixels < pixels:
            numbers = (i + (weights[i : i + _PIECE] > 0).nonzero()[0] for i in pieces)
            plan = {"drawable": ArrayPlan(np.int64, (self._drawable_pixels,))}
            made = _made(folder, "drawable", self._weights.digest, plan, numbers)
            self._drawable = made.arrays["drawable"]

    def move_to(self, device: torch.device) -> None:
        """See :class:`PosedPixels`; the files stay where they are, each batch is moved."""
        self._device = device

    @property
    def drawable_pixels(self) -> int:
        """Pixels of positive weight."""
        return self._drawable_pixels

    def fingerprint(self) -> str:
        """See :class:`PosedPixels`; no pixel is read."""
        weights, directions = self._weights.digest, self._directions.digest
        return fingerprint_of(self._photographs.digest, weights, directions, self.T_world_camera)

    def _rays(self, pixel: Int[Tensor, "r"]) -> RayBatch:
        pixel = pixel.cpu()
        image = torch.searchsorted(self._first_pixel, pixel, right=True) - 1
        rows = (pixel + self._direction_shift[image]).numpy()
        colour_and_alpha = torch.from_numpy(self._photographs.pixels[pixel.numpy()])
        drawn = PixelTable(
            colour_and_alpha[:, :3].contiguous(),
            torch.from_numpy(self._weights.arrays["weights"][pixel.numpy()]),
            image.to(torch.int32),
            torch.from_numpy(self._directions.arrays["directions"][rows]),
            torch.zeros(len(self.images), dtype=torch.long),
            self.T_world_camera.contiguous(),
            colour_and_alpha[:, 3].contiguous() if self._cut_out else None,
        )
        batch = gather_rays(drawn, torch.arange(len(pixel)), find_native_library()[0])
        moved = {f.name: value for f in fields(batch) if isinstance(value := getattr(batch, f.name), Tensor)}
        return replace(batch, **{name: value.to(self._device) for name, value in moved.items()})

    def _drawn(self, number: Int[Tensor, "r"]) -> Int[Tensor, "r"]:
        return number if self._drawable is None else torch.from_numpy(self._drawable[number.cpu().numpy()])

    def _weight_maps(self, folder: Path) -> Iterator[NDArray]:
        """As :meth:`Weighting.weight_maps`, the maps waiting on disk until the best mean is known."""
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as waiting:
            best = None
            raw_maps = self._weighting.raw_maps(self.images, self._space)
            for image, weight_map in zip(self.images, raw_maps, strict=True):
                check_weight_map(image, weight_map)
                mean = float(weight_map.mean())
                best = mean if best is None else max(best, mean)
                waiting.write(weight_map.contiguous().numpy().data)
            waiting.seek(0)
            for image in self.images:
                h, w = image.colour.shape[:2]
                raw = torch.frombuffer(bytearray(waiting.read(4 * h * w)), dtype=torch.float32).view(h, w)
                yield self._weighting.relative(raw, best or 0.0).numpy()


def _made(
    folder: Path, name: str, made_from: str, plans: dict[str, ArrayPlan], pieces: Iterator[NDArray]
) -> MappedArrays:
    """The arrays of a file named by what they are made from; written first where they are not there."""
    key = hashlib.sha256(made_from.encode()).hexdigest()[:24]
    path = folder / f"{name}-{key}.safetensors"
    found = map_arrays(path, key)
    if found is None:
        write_arrays(path, key, plans, pieces)
        found = map_arrays(path, key)
    assert found is not None, "a file just written can be read"
    return found
