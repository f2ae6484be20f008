"""Image sets of the NeRF-synthetic kind: ``transforms_train.json`` and ``transforms_test.json``."""

import math
from pathlib import Path

from mulan.errors import InputError
from mulan.geometry.camera import PinholeCamera
from mulan.mission import json_fields, pixels
from mulan.mission.posed_images import PosedImage, PosedImageSet

TRAIN, TEST = "transforms_train.json", "transforms_test.json"


def read_blender(folder: Path) -> PosedImageSet:
    """Read a NeRF-synthetic scene (Mildenhall et al. 2020); the ``val`` split is ignored.

    One lens for a split, from ``camera_angle_x``; its size is that of each image. Without a test file the
    test split is empty.

    Raises:
        InputError: A file, image, pose or ``camera_angle_x`` is missing or cannot be used.
    """
    test = read_split(folder / TEST) if (folder / TEST).exists() else ()
    return PosedImageSet(read_split(folder / TRAIN), test, folder)


def read_split(path: Path) -> tuple[PosedImage, ...]:
    """The photographs of one ``transforms_*.json``; see :func:`read_blender`."""
    record = json_fields.load_object(path)
    angle_rad = json_fields.number(record, "camera_angle_x", path)
    if angle_rad is None or not 0 < angle_rad < math.pi:
        raise InputError(
            path, "camera_angle_x", "is missing or not within (0, π)", "give the horizontal view angle"
        )
    images = []
    for frame in json_fields.frames(record, path):
        file = image_file(path.parent, frame["file_path"])
        width, height = pixels.image_size(file, str(file))
        focal = 0.5 * width / math.tan(0.5 * angle_rad)
        camera = PinholeCamera(width, height, focal, focal, width / 2, height / 2)
        images.append(PosedImage(file, camera, json_fields.pose(frame, path)))
    return tuple(images)


def image_file(folder: Path, file_path: str) -> Path:
    """File of a frame; names without an extension are PNG."""
    file = folder / file_path
    return file if file.suffix else file.with_name(file.name + ".png")
