"""Photographs of a posed image set brought into one folder of their own."""

import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mulan.errors import InputError
from mulan.mission.posed_images import PosedImage, PosedImageSet
from mulan.mission.run_folder import write_atomically

_STRANGE = re.compile(r"[^A-Za-z0-9._-]")  # anything that could leave the folder, or trouble another program


def place_images(images: PosedImageSet, folder: Path, link: bool) -> PosedImageSet:
    """Copy every photograph to ``<folder>/<robot>_<name>``; names flat, since other trainers drop folders.

    A photograph that is there already with the same content (or is the same file) is kept.

    Args:
        images: The set; its files are left as they are.
        folder: Where to.
        link: Hard links instead of copies where the file system allows, which cost no space.

    Returns:
        The set with the paths of the copies.

    Raises:
        InputError: A photograph is missing, the disk is full or the folder cannot be written.
    """
    everything = (*images.train, *images.test)
    names = flat_names(everything)
    placed = []
    for image, name in zip(everything, names, strict=True):
        target = folder / name
        _place(image.path, target, link)
        placed.append(replace(image, path=target))
    count = len(images.train)
    return replace(images, train=tuple(placed[:count]), test=tuple(placed[count:]))


def flat_names(images: Sequence[PosedImage]) -> list[str]:
    """A file name for each photograph, all different: its own, behind its robot's if it has one."""
    names: list[str] = []
    taken: set[str] = set()
    for image in images:
        own = image.path.name if image.robot_id is None else f"{image.robot_id}_{image.path.name}"
        own = _STRANGE.sub("_", own).lstrip(".") or "image"
        name, number = own, 1
        while name.lower() in taken:  # some file systems ignore case
            number += 1
            stem, dot, suffix = own.rpartition(".")
            name = f"{stem}-{number}{dot}{suffix}" if dot else f"{own}-{number}"
        taken.add(name.lower())
        names.append(name)
    return names


def _place(source: Path, target: Path, link: bool) -> None:
    if not source.is_file():
        raise InputError(source, "image", "does not exist", "check the path to the photograph")
    if target.exists() and _same(source, target):
        return

    if not (link and _linked(source, target)):
        write_atomically(target, lambda temporary: shutil.copyfile(source, temporary))


def _linked(source: Path, target: Path) -> bool:
    """Hard-link a file; False where the file system does not."""
    temporary = target.with_name(f".{target.name}.link")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)
        os.link(source.resolve(), temporary)
        os.replace(temporary, target)
    except OSError:
        return False
    return True


def _same(source: Path, target: Path) -> bool:
    if source.samefile(target):
        return True
    return source.stat().st_size == target.stat().st_size and source.read_bytes() == target.read_bytes()
