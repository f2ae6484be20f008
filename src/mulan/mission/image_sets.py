"""Posed photographs from whatever format a folder holds."""

from pathlib import Path

from mulan.errors import InputError
from mulan.mission import blender
from mulan.mission.blender import read_blender
from mulan.mission.nerfstudio import read_transforms
from mulan.mission.posed_images import PosedImageSet

TRANSFORMS = "transforms.json"


def read_posed_images(source: Path, hold_out_every: int | None = 8) -> PosedImageSet:
    """Read a NeRF-synthetic folder, or a nerfstudio / instant-ngp ``transforms.json`` or its folder.

    Args:
        source: The folder or the JSON file.
        hold_out_every: Where the set itself names no test frames, frames 0, n, 2n, ... in file order become
            the test views (the custom of LLFF and mip-NeRF 360); None holds out none.

    Raises:
        InputError: There is no such set, something in it cannot be used, or no frame would be left to learn
            from.
    """
    images = _read(source)
    if not images.test and hold_out_every is not None:
        images = _hold_out(images, hold_out_every)
    if not images.train:
        raise InputError(source, "frames", "none is left to learn from", "add photographs or hold fewer out")
    return images


def _read(source: Path) -> PosedImageSet:
    if source.is_dir():
        if (source / blender.TRAIN).exists():
            return read_blender(source)
        if (source / TRANSFORMS).exists():
            return read_transforms(source / TRANSFORMS)
        raise InputError(
            source,
            "folder",
            f"holds neither {blender.TRAIN} nor {TRANSFORMS}",
            "name a folder of posed images or a JSON file",
        )
    if source.name == blender.TRAIN:
        return read_blender(source.parent)
    return read_transforms(source)


def _hold_out(images: PosedImageSet, every: int) -> PosedImageSet:
    if every < 2:
        raise InputError(images.source, "hold_out_every", f"is {every}", "hold out every 2nd frame or fewer")
    train = tuple(image for index, image in enumerate(images.train) if index % every)
    return PosedImageSet(train, images.train[::every], images.source)
