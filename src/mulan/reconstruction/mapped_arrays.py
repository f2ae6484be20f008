"""Arrays larger than memory: a safetensors file written piece by piece and read page by page."""

import hashlib
import json
import math
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike, NDArray

from mulan.errors import InputError
from mulan.mission.run_folder import write_atomically

_TYPES = {"U8": np.dtype(np.uint8), "F32": np.dtype(np.float32), "I64": np.dtype(np.int64)}
_LARGEST_HEADER = 2**20


@dataclass(frozen=True)
class ArrayPlan:
    """An array that is to be written.

    Attributes:
        dtype: uint8, float32 or int64; wider ones come first in a file, so that all are aligned.
        shape: Its shape.
    """

    dtype: DTypeLike
    shape: tuple[int, ...]

    @property
    def bytes(self) -> int:
        """Its size."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class MappedArrays:
    """Arrays of a file, read-only; each page is read when first looked at and may be forgotten again.

    Attributes:
        arrays: By name.
        digest: Of their contents, noted when they were written.
    """

    arrays: dict[str, NDArray]
    digest: str


def write_arrays(path: Path, key: str, plans: dict[str, ArrayPlan], pieces: Iterable[NDArray]) -> None:
    """Write arrays from pieces, in the order of the plans; the file appears whole or not at all.

    Args:
        path: File to write.
        key: What the contents were made from, for :func:`map_arrays`.
        plans: Arrays by name.
        pieces: Consecutive parts of all of them.

    Raises:
        InputError: The disk is too full or the folder cannot be written.
    """
    needed = sum(plan.bytes for plan in plans.values())
    _check_room(path, needed)

    def write(temporary: Path) -> None:
        digest = hashlib.sha256()
        with open(temporary, "wb") as file:
            start = file.write(_header(key, "0" * 64, plans))
            for piece in pieces:
                data = np.ascontiguousarray(piece).reshape(-1).view(np.uint8).data
                digest.update(data)
                file.write(data)
            assert file.tell() - start == needed, "the pieces are not what was planned"
            file.seek(0)
            file.write(_header(key, digest.hexdigest(), plans))

    write_atomically(path, write)


def map_arrays(path: Path, key: str) -> MappedArrays | None:
    """The arrays of a file, if it is there, whole, and was written with this key."""
    try:
        with open(path, "rb") as file:
            length = int.from_bytes(file.read(8), "little")
            header = json.loads(file.read(length)) if length <= _LARGEST_HEADER else {}
        facts = header.pop("__metadata__")
        if facts["key"] != key or path.stat().st_size != 8 + length + _end(header):
            return None
        arrays = {name: _mapped(path, 8 + length, entry) for name, entry in header.items()}
        return MappedArrays(arrays, facts["digest"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _end(entries: dict[str, dict]) -> int:
    return max(entry["data_offsets"][1] for entry in entries.values())


def _mapped(path: Path, start: int, entry: dict) -> NDArray:
    dtype, shape = _TYPES[entry["dtype"]], tuple(entry["shape"])
    if math.prod(shape) == 0:
        return np.empty(shape, dtype)
    mapped = np.memmap(path, dtype, mode="r", offset=start + entry["data_offsets"][0], shape=shape)
    return np.asarray(mapped)


def _header(key: str, digest: str, plans: dict[str, ArrayPlan]) -> bytes:
    names, at = {dtype: name for name, dtype in _TYPES.items()}, 0
    header: dict[str, dict] = {"__metadata__": {"key": key, "digest": digest}}
    for name, plan in plans.items():
        offsets = [at, at + plan.bytes]
        header[name] = {"dtype": names[np.dtype(plan.dtype)], "shape": plan.shape, "data_offsets": offsets}
        at = offsets[1]
    text = json.dumps(header).encode()
    text = text.ljust(len(text) + -len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def _check_room(path: Path, needed: int) -> None:
    folder = path.parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise InputError(
            path,
            "writing",
            f"needs {needed / 1e9:.2f} GB and the disk has {free / 1e9:.2f} GB left",
            "free some space, or name another folder with --image-cache",
        )
