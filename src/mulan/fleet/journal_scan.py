"""What an MCAP file holds, read so that a cut end does no harm."""

import mmap
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from mulan.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
_LENGTH = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")


@dataclass(frozen=True)
class RecordedMessage:
    """One message of a journal.

    Attributes:
        channel: Its channel.
        sequence: Number the sender gave it.
        log_ns: When it was received, on the base station's clock.
        record_ns: When it was recorded, on the robot's clock.
        payload: CDR bytes.
    """

    channel: Channel
    sequence: int
    log_ns: int
    record_ns: int
    payload: bytes


@dataclass
class JournalScan:
    """Where the data of a file ends and what came before.

    Attributes:
        end: Offset after the last whole record of the data section.
        schemas, channels: By id.
        message_counts: By channel id.
        first_log_ns, last_log_ns: Of all messages; 0 without any.
    """

    end: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    message_counts: dict[int, int] = field(default_factory=dict)
    first_log_ns: int = 0
    last_log_ns: int = 0


def scan(path: Path, into: JournalScan) -> Iterator[RecordedMessage]:
    """Every whole message of an unchunked file, in the order written; ``into`` is filled on the way.

    A scan that was used before goes on behind what it has.

    Raises:
        InputError: The file is not MCAP, or not one a journal wrote.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError(path, "file", "is not an MCAP file", "choose another --out")
        into.end = max(into.end, len(MAGIC))
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield from _records(path, data, size, into)


def _records(path: Path, data: mmap.mmap, size: int, into: JournalScan) -> Iterator[RecordedMessage]:
    while into.end + _LENGTH.size <= size:
        opcode, length = _LENGTH.unpack_from(data, into.end)
        begin = into.end + _LENGTH.size
        if begin + length > size or opcode not in _IN_DATA:
            return  # the end of the data, or the record a crash cut
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_ns, record_ns = _MESSAGE.unpack_from(data, begin)
            if channel_id not in into.channels:
                return
            payload = data[begin + _MESSAGE.size : begin + length]
            into.message_counts[channel_id] = into.message_counts.get(channel_id, 0) + 1
            into.first_log_ns = into.first_log_ns or log_ns
            into.last_log_ns = log_ns
            into.end = begin + length
            yield RecordedMessage(into.channels[channel_id], sequence, log_ns, record_ns, payload)
            continue
        if opcode == Opcode.CHUNK:
            problem = "holds chunks, so no journal wrote it"
            raise InputError(path, "MCAP records", problem, "choose another --out")
        stream = ReadDataStream(BytesIO(data[begin : begin + length]))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            into.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            into.channels[channel.id] = channel
        into.end = begin + length


_IN_DATA = (
    Opcode.HEADER,
    Opcode.SCHEMA,
    Opcode.CHANNEL,
    Opcode.MESSAGE,
    Opcode.CHUNK,
    Opcode.METADATA,
    Opcode.ATTACHMENT,
)
