"""The chain of records in an Intel 5300 .dat file: where each one with channel state begins and ends."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int
from numpy.typing import NDArray

from mulan.errors import InputError
from mulan.wireless.recordings.chip import HEADER_BYTES, INTEL_CSI_CODE, describe_header

# other messages of the driver's connector (iwl-connector.h); they carry no channel state
_OTHER_CODES = frozenset({0x1C, 0x1D, 0x1E, 0xC0, 0xC1, 0xC3, 0xD0})
_MOST_UNKNOWN = 0.01  # share of records with an unknown code before the chain counts as broken
_LONGEST_RECORD = 4096  # a received frame (code 193) with its headers
_REMEDY = "record again, or copy the file again if it was damaged"


@dataclass(frozen=True)
class RecordChain:
    """Records of one file.

    Attributes:
        path: The file.
        data: All its bytes.
        start: First payload byte of each record with channel state.
        length: Bytes of its payload.
        other_records: How many records carry something else.
        cut_bytes: Length of a last record that was cut off and left out.
        padding_bytes: Zeros after the last record.
    """

    path: Path
    data: bytes
    start: Int[NDArray, "n"]
    length: Int[NDArray, "n"]
    other_records: int
    cut_bytes: int
    padding_bytes: int

    def refuse(self, bad: Bool[NDArray, "n"], field: str, problem: str, *values: NDArray) -> None:
        """Raise for the first bad record.

        Args:
            bad: Which records are bad.
            field: What is wrong.
            problem: Sentence with one ``{}`` for each of ``values``, filled with the bad record's entry.
            values: One entry a record each.

        Raises:
            InputError: A record is bad.
        """
        if bad.any():
            k = int(np.argmax(bad))
            told = problem.format(*(value[k] for value in values))
            raise malformed(self.path, self.data, int(self.start[k]) - 3, field, told)


def malformed(path: Path, data: bytes, position: int, field: str, problem: str) -> InputError:
    """The error for the record at a byte; at the first one it says what the header looks like."""
    if position == 0:
        problem += f"; the file {describe_header(data[:HEADER_BYTES])}"
    return InputError(path, field, f"of the record at byte {position} {problem}", _REMEDY)


def walk_records(path: Path, data: bytes) -> RecordChain:
    """Follow the chain from the first byte to the last.

    Raises:
        InputError: A length is impossible, too many codes are unknown, or no record carries channel state.
    """
    starts, lengths, other, unknown = [], [], 0, []
    position, size, cut, padding = 0, len(data), 0, 0
    while position < size:
        left = size - position
        if left < 3 or data[position : position + 2] == b"\0\0":
            if data.count(0, position) == left:
                padding = left
            elif left < 3:
                cut = left
            else:
                raise malformed(path, data, position, "length", "is zero although bytes follow")
            break
        length, code = struct.unpack_from(">HB", data, position)
        if length > _LONGEST_RECORD:
            raise malformed(path, data, position, "length", f"is {length}, longer than any record")
        if length + 2 > left:
            # a wrong length near the end would look like a cut too
            if code != INTEL_CSI_CODE or (lengths and length - 1 not in lengths):
                raise malformed(path, data, position, "length", f"is {length} but {left - 2} bytes follow")
            cut = left
            break
        if code == INTEL_CSI_CODE:
            starts.append(position + 3)
            lengths.append(length - 1)
        else:
            other += 1
            if code not in _OTHER_CODES:
                unknown.append((position, code))
        position += 2 + length
    if len(unknown) > _MOST_UNKNOWN * (len(starts) + other):
        at, code = unknown[0]
        raise malformed(path, data, at, "code", f"is {code}, unknown ({len(unknown)} such records)")
    if not starts:
        raise InputError(
            path,
            "records",
            f"none carries channel state (code 187); the file {describe_header(data[:HEADER_BYTES])}",
            _REMEDY,
        )
    return RecordChain(path, data, np.array(starts), np.array(lengths), other, cut, padding)
