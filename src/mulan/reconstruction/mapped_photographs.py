"""Photographs decoded once into a file and read from there, for sets larger than memory."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.mission.pixels import resized_shape
from mulan.mission.posed_images import PosedImage
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.mapped_arrays import ArrayPlan, map_arrays, write_arrays

BYTES_A_PIXEL = 22  # of a photograph learnt from in memory: colour twice, alpha, weight, image, drawing list
_VERSION = "1"


@dataclass(frozen=True)
class MappedPhotographs:
    """Photographs whose pixels stay on disk.

    Attributes:
        images: As :func:`load_captured` gives them; their arrays are read from the file when looked at.
        pixels: All of them, row by row: colour over white, coverage.
        digest: Of the pixels.
    """

    images: tuple[CapturedImage, ...]
    pixels: UInt8[NDArray, "n 4"]
    digest: str


def decoded_bytes(images: Sequence[PosedImage], longest_side: int | None) -> int:
    """Memory it takes to learn from photographs held in memory."""
    return BYTES_A_PIXEL * sum(w * h for w, h in _sizes(images, longest_side))


def map_photographs(
    images: Sequence[PosedImage], longest_side: int | None, folder: Path
) -> MappedPhotographs:
    """Photographs from the folder's file, decoded into it first where it does not hold just these.

    The files' names, sizes and times of change tell whether they are the same; they are not read again.

    Raises:
        InputError: A photograph is missing or damaged, or the disk is full.
    """
    sizes = _sizes(images, longest_side)
    key = _key(images, longest_side)
    path = folder / f"photographs-{key}.safetensors"
    found = map_arrays(path, key)
    if found is None:
        plans = {
            "pixels": ArrayPlan(np.uint8, (sum(w * h for w, h in sizes), 4)),
            "has_alpha": ArrayPlan(np.uint8, (len(images),)),
        }
        write_arrays(path, key, plans, _decoded(images, sizes, longest_side))
        found = map_arrays(path, key)
    if found is None:
        raise InputError(path, "file", "vanished while it was being written", "run the command again")
    pixels, has_alpha = found.arrays["pixels"], found.arrays["has_alpha"]
    captured, first = [], 0
    for posed, (w, h), alpha in zip(images, sizes, has_alpha, strict=True):
        rgba = pixels[first : first + w * h].reshape(h, w, 4)
        camera = posed.camera.resized(width=w, height=h)
        captured.append(CapturedImage(posed, camera, rgba[..., :3], rgba[..., 3] if alpha else None))
        first += w * h
    return MappedPhotographs(tuple(captured), pixels, found.digest)


def _sizes(images: Sequence[PosedImage], longest_side: int | None) -> list[tuple[int, int]]:
    return [resized_shape(image.camera.width, image.camera.height, longest_side) for image in images]


def _decoded(
    images: Sequence[PosedImage], sizes: list[tuple[int, int]], longest_side: int | None
) -> Iterator[NDArray]:
    has_alpha = np.zeros(len(images), np.uint8)
    for i, (posed, (w, h)) in enumerate(zip(images, sizes, strict=True)):
        [image] = load_captured([posed], longest_side)
        if image.colour.shape[:2] != (h, w):
            raise InputError(posed.path, "image", "has another size than its camera", "calibrate it again")
        has_alpha[i] = image.alpha is not None
        yield image.colour_and_alpha
    yield has_alpha


def _key(images: Sequence[PosedImage], longest_side: int | None) -> str:
    digest = hashlib.sha256(f"{_VERSION} {longest_side}".encode())
    for image in images:
        try:
            stat = image.path.stat()
        except OSError as error:
            raise InputError(
                image.path, "image", error.strerror or str(error), "check the path to the photograph"
            ) from error
        size = image.camera.width, image.camera.height
        digest.update(f"{image.path.resolve()}|{stat.st_size}|{stat.st_mtime_ns}|{size}|".encode())
    return digest.hexdigest()[:24]
