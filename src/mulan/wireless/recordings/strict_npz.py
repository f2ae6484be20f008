"""Arrays of an .npz file: sizes checked before anything is decompressed, and no pickle ever opened."""

import io
import lzma
import math
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from mulan.errors import InputError

MAX_MEMBER_BYTES = 16 * 2**20  # a WSR member has at most 64 kB; one hour of CSI would still fit
MAX_TOTAL_BYTES = 128 * 2**20
MAX_MEMBERS = 1024
_REMEDY = "decode the recording again, or copy the file again if it was cut"
_NUMBERS_AND_TEXT = "biufcU"


def read_strict_npz(path: Path) -> dict[str, NDArray]:
    """All arrays of an .npz file.

    Raises:
        InputError: Not a zip archive, damaged, larger than the limits above, or a member that is no plain
            array of numbers or text (objects would need pickle).
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check_sizes(path, members)
            return {
                member.filename.removesuffix(".npy"): _array(path, member, _bounded(path, archive, member))
                for member in members
            }
    except OSError as fault:
        raise InputError(
            path, "file", f"cannot be read ({fault})", "check the path and permissions"
        ) from fault
    except (
        zipfile.BadZipFile,
        zlib.error,
        lzma.LZMAError,
        EOFError,
        struct.error,
        NotImplementedError,
        RuntimeError,  # encrypted
        ValueError,
        OverflowError,
    ) as fault:
        raise InputError(path, "archive", f"is no readable .npz file ({fault})", _REMEDY) from fault


def _check_sizes(path: Path, members: list[zipfile.ZipInfo]) -> None:
    if not members or len(members) > MAX_MEMBERS:
        raise InputError(
            path, "archive", f"has {len(members)} members instead of 1 to {MAX_MEMBERS}", _REMEDY
        )
    names = [member.filename for member in members]
    if len(set(names)) < len(names):
        double = next(name for name in names if names.count(name) > 1)
        raise InputError(path, double, "occurs twice in the archive", _REMEDY)
    for member in members:
        if member.file_size > MAX_MEMBER_BYTES:
            raise InputError(
                path,
                member.filename,
                f"would unpack to {member.file_size} bytes, more than the limit of {MAX_MEMBER_BYTES}",
                "split the recording",
            )
    total = sum(member.file_size for member in members)
    if total > MAX_TOTAL_BYTES:
        raise InputError(
            path,
            "archive",
            f"would unpack to {total} bytes, more than the limit of {MAX_TOTAL_BYTES}",
            "split the recording",
        )


def _bounded(path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    with archive.open(member) as stream:
        data = stream.read(member.file_size + 1)  # reading to the declared end also checks the CRC
        if len(data) != member.file_size or stream.read(1):
            raise InputError(path, member.filename, "is not as long as the archive says", _REMEDY)
    return data


def _array(path: Path, member: zipfile.ZipInfo, data: bytes) -> NDArray:
    stream = io.BytesIO(data)
    try:
        version = npy.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"version {version} of the .npy format")
        read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran_order, dtype = read_header(stream)
    except Exception as fault:  # numpy parses it as Python text, which fails in many ways
        raise InputError(path, member.filename, f"has no valid .npy header ({fault})", _REMEDY) from fault
    if dtype.kind not in _NUMBERS_AND_TEXT:
        raise InputError(
            path, member.filename, f"has elements of type {dtype}, not numbers or text", "store plain arrays"
        )
    body = data[stream.tell() :]
    if min(shape, default=1) < 0 or math.prod(shape) * dtype.itemsize != len(body):
        raise InputError(
            path, member.filename, f"says shape {shape} of {dtype} but holds {len(body)} bytes", _REMEDY
        )
    flat = np.frombuffer(body, dtype) if body else np.empty(0, dtype)
    return flat.reshape(shape, order="F" if fortran_order else "C")
