"""Photographs for a training: in memory where they fit, else in files."""

import logging
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from mulan.mission.posed_images import PosedImageSet
from mulan.radiance.space import SceneSpace
from mulan.reconstruction.available_memory import available_bytes
from mulan.reconstruction.captured_image import CapturedImage, load_captured
from mulan.reconstruction.dataset import ImageTensors
from mulan.reconstruction.mapped_images import MappedImages
from mulan.reconstruction.mapped_photographs import MappedPhotographs, decoded_bytes, map_photographs
from mulan.reconstruction.posed_pixels import PosedPixels
from mulan.reconstruction.process_group import ProcessGroup
from mulan.reconstruction.train_config import TrainConfig
from mulan.reconstruction.weights import Weighting

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Photographs:
    """What a training learns from and is tested on.

    Attributes:
        train, test: The photographs.
    """

    train: tuple[CapturedImage, ...]
    test: tuple[CapturedImage, ...]

    def with_weights(self, weighting: Weighting, space: SceneSpace) -> PosedPixels:
        """Rays to learn from, each pixel with its weight."""
        return ImageTensors(self.train, weighting.weight_maps(self.train, space))


@dataclass(frozen=True)
class FiledPhotographs(Photographs):
    """The same, in files of a folder."""

    mapped: MappedPhotographs
    folder: Path
    group: ProcessGroup | None = field(default=None)

    def with_weights(self, weighting: Weighting, space: SceneSpace) -> PosedPixels:
        """Rays to learn from, each pixel with its weight; both stay on disk."""
        with self.group.leader_first() if self.group else nullcontext():
            return MappedImages(self.mapped, weighting, space, self.folder)


def load_photographs(
    images: PosedImageSet, config: TrainConfig, folder: Path, group: ProcessGroup | None = None
) -> Photographs:
    """Read photographs at the size trained at, into memory or, where they would not fit, into files.

    Args:
        images: Files and poses.
        config: Image size, share of the free memory, folder.
        folder: For the files, unless ``config`` names another.
        group: Processes that train together; the leader decodes, and all map the same file.

    Raises:
        InputError: A photograph is missing or damaged, or the disk is full.
    """
    everything = (*images.train, *images.test)
    needed, free = decoded_bytes(everything, config.image_size), available_bytes()
    if group:
        # one decision for all, and room for a copy in each process
        needed, free = group.broadcast_json([needed * group.place.local_processes, free])
    if needed <= config.image_memory_share * free:
        size = config.image_size
        return Photographs(load_captured(images.train, size), load_captured(images.test, size))
    folder = config.image_cache or folder
    _log.warning(
        "learning from the decoded photographs would take %.2f GB and %.2f GB are free: they are kept in %s",
        *(needed / 1e9, free / 1e9, folder),
    )
    with group.leader_first() if group else nullcontext():
        mapped = map_photographs(images.train, config.image_size, folder)
        test = map_photographs(images.test, config.image_size, folder).images if images.test else ()
    return FiledPhotographs(mapped.images, test, mapped, folder, group)
