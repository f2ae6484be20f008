"""Photographs out of the bag and into a run's folder, byte for byte."""

from pathlib import Path

from mulan.mission.messages import HELD_OUT
from mulan.mission.run_folder import RunFolder, write_atomically
from mulan.mission.types import Mission, Photo

_SUFFIX = {"jpeg": "jpg", "png": "png"}


def extract_photos(mission: Mission, run: RunFolder) -> dict[str, list[Path]]:
    """Write every photograph as ``images/<robot>/000000.jpg`` (or ``.png``), numbered in order of time.

    Returns:
        Files by robot name, in the order of ``RobotLog.photos``; test views, if any, under ``"held_out"``.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    files = {log.name: _write(log.photos, run.images / log.name) for log in mission.robots}
    if mission.held_out is not None:
        files[HELD_OUT] = _write(mission.held_out.photos, run.images / HELD_OUT)
    return files


def _write(photos: tuple[Photo, ...], folder: Path) -> list[Path]:
    paths = []
    for index, photo in enumerate(photos):
        path = folder / f"{index:06d}.{_SUFFIX[photo.encoding]}"
        write_atomically(path, lambda temporary, data=photo.data: temporary.write_bytes(data))
        paths.append(path)
    return paths
