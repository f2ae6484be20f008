"""Whether a file can be a shared library at all, before the loader is asked."""

import struct
from pathlib import Path

_ELF64 = struct.Struct("<4sBB10xHHIQQQIHHHHHH")
_LITTLE_ENDIAN_64_BIT = (2, 1)


def check_not_cut_off(path: Path) -> None:
    """Refuse an ELF file that ends before its section table does.

    The loader maps such a file all the same, and the process dies of SIGBUS where the missing part is
    touched. Other formats are left to the loader, which checks them.

    Raises:
        OSError: The file is cut off, or cannot be read.
    """
    with path.open("rb") as file:
        start = file.read(_ELF64.size)
    if len(start) < _ELF64.size:
        raise OSError(f"{path} is cut off: it has {len(start)} bytes")
    magic, bits, order, *_, section_at, _, _, _, _, section_size, sections, _ = _ELF64.unpack(start)
    if magic != b"\x7fELF" or (bits, order) != _LITTLE_ENDIAN_64_BIT:
        return
    end, size = section_at + section_size * sections, path.stat().st_size
    if size < end:
        raise OSError(f"{path} is cut off: it has {size} bytes of at least {end}")
