"""The base station's bag: an MCAP file that grows record by record and survives being killed."""

import fcntl
import os
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Footer, Header, Schema, Statistics

from mulan.errors import InputError
from mulan.fleet.journal_scan import MAGIC, JournalScan, RecordedMessage, scan
from mulan.mission import messages

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_MESSAGE_FIELDS = 22  # bytes of a message record before its payload
_INCARNATION = "mulan_incarnation"
_ROBOT = "mulan_robot"


@dataclass(frozen=True)
class Entry:
    """A message to be written.

    Attributes:
        topic, msgtype: As in the bag.
        robot: Who sent it; empty for the base station itself.
        incarnation, sequence: Which message of that robot it is.
        record_ns: When it was recorded, on the robot's clock.
        received_ns: When it came, on the base station's clock.
        payload: CDR bytes.
    """

    topic: str
    msgtype: str
    robot: str
    incarnation: int
    sequence: int
    record_ns: int
    received_ns: int
    payload: bytes


class Journal:
    """An open bag. One process at a time may have it open.

    A bag that was cut short, or closed in good order, is gone on with: what lies after the last whole message
    is cut off and new messages follow. While it is open the bag lacks its last few bytes (the index a reader
    asks for); ``close`` writes them.

    Attributes:
        path: The file.
        durable: Whether every append also waits for the disk itself (a power cut loses nothing then).
    """

    def __init__(
        self,
        path: Path,
        durable: bool = True,
        replay: Callable[[RecordedMessage], object] = lambda _: None,
    ) -> None:
        """Open or make the bag.

        Args:
            path: A name ending in ``.mcap``.
            durable: As the attribute.
            replay: Called with every message already in the bag.

        Raises:
            InputError: The name does not end in ``.mcap``, the file is not a journal or cannot be written, or
                another process has it open.
        """
        if path.suffix != ".mcap":
            raise InputError(path, "file name", "does not end in .mcap", "choose a name such as mission.mcap")
        self.path = path
        self.durable = durable
        self._file = _locked(path)
        self._scan = JournalScan()
        self._channels: dict[tuple[str, str, str, int], int] = {}
        if os.fstat(self._file).st_size < len(MAGIC):
            self._begin()
        else:
            self._go_on(replay)

    @property
    def messages(self) -> int:
        """How many it holds."""
        return sum(self._scan.message_counts.values())

    def append(self, entries: Sequence[Entry]) -> None:
        """Write messages, all or none; when this returns they outlive the process.

        Raises:
            OSError: They could not be written (the disk is full); the bag is as it was before.
        """
        known, schemas = dict(self._channels), dict(self._scan.schemas)
        channels = dict(self._scan.channels)
        last_ns, counts = self._scan.last_log_ns, dict(self._scan.message_counts)
        parts: list[bytes] = []
        for entry in entries:
            channel = self._channel(entry, parts)
            # readers without an index want the order of time, also when the clock was set back
            last_ns = max(last_ns, entry.received_ns)
            length = _MESSAGE_FIELDS + len(entry.payload)
            parts.append(
                _MESSAGE_HEAD.pack(Opcode.MESSAGE, length, channel, entry.sequence, last_ns, entry.record_ns)
            )
            parts.append(entry.payload)
            counts[channel] = counts.get(channel, 0) + 1
        try:
            self._write(b"".join(parts))
        except OSError:
            self._channels, self._scan.schemas, self._scan.channels = known, schemas, channels
            raise
        self._scan.first_log_ns = self._scan.first_log_ns or last_ns
        self._scan.last_log_ns, self._scan.message_counts = last_ns, counts

    def close(self) -> None:
        """Write the end a reader asks for, and let go of the file.

        Raises:
            OSError: It could not be written; the messages are safe, and opening the bag again goes on.
        """
        if self._file < 0:
            return
        try:
            end = self._scan.end
            self._write(self._summary())
            self._scan.end = end
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Let go of the file as it is, as a crash would."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _begin(self) -> None:
        builder = RecordBuilder()
        Header(profile="ros2", library="mulan").write(builder)
        os.ftruncate(self._file, 0)
        self._scan.end = 0
        try:
            self._write(MAGIC + builder.end())
        except OSError as error:
            self.abandon()
            remedy = "free some space or choose another folder"
            raise InputError(self.path, "writing", error.strerror or str(error), remedy) from error

    def _go_on(self, replay: Callable[[RecordedMessage], object]) -> None:
        try:
            for message in scan(self.path, self._scan):
                replay(message)
        except BaseException:
            self.abandon()
            raise
        if self._scan.end == len(MAGIC):
            self._begin()  # killed before the header was whole
            return
        for channel in self._scan.channels.values():
            key = (
                channel.topic,
                self._scan.schemas[channel.schema_id].name,
                channel.metadata.get(_ROBOT, ""),
                int(channel.metadata.get(_INCARNATION, "0"), 16),
            )
            self._channels[key] = channel.id
        os.ftruncate(self._file, self._scan.end)

    def _channel(self, entry: Entry, parts: list[bytes]) -> int:
        key = entry.topic, entry.msgtype, entry.robot, entry.incarnation
        if key in self._channels:
            return self._channels[key]
        builder = RecordBuilder()
        schema_id = next((s.id for s in self._scan.schemas.values() if s.name == entry.msgtype), None)
        if schema_id is None:
            schema_id = len(self._scan.schemas) + 1
            text, _ = messages.typestore().generate_msgdef(entry.msgtype, ros_version=2)
            schema = Schema(id=schema_id, name=entry.msgtype, encoding="ros2msg", data=text.encode())
            schema.write(builder)
            self._scan.schemas[schema_id] = schema
        metadata = {"offered_qos_profiles": ""}
        if entry.robot:
            metadata |= {_ROBOT: entry.robot, _INCARNATION: f"{entry.incarnation:016x}"}
        channel = Channel(
            id=len(self._scan.channels) + 1,
            topic=entry.topic,
            message_encoding="cdr",
            metadata=metadata,
            schema_id=schema_id,
        )
        channel.write(builder)
        parts.append(builder.end())
        self._scan.channels[channel.id] = channel
        self._channels[key] = channel.id
        return channel.id

    def _write(self, data: bytes) -> None:
        view, written = memoryview(data), 0
        try:
            while written < len(data):
                written += os.pwrite(self._file, view[written:], self._scan.end + written)
            if self.durable:
                os.fdatasync(self._file)
        except OSError:
            os.ftruncate(self._file, self._scan.end)
            raise
        self._scan.end += written

    def _summary(self) -> bytes:
        builder = RecordBuilder()
        DataEnd(data_section_crc=0).write(builder)
        data_end = builder.end()
        for schema in self._scan.schemas.values():
            schema.write(builder)
        for channel in self._scan.channels.values():
            channel.write(builder)
        Statistics(
            attachment_count=0,
            channel_count=len(self._scan.channels),
            channel_message_counts=self._scan.message_counts,
            chunk_count=0,
            message_count=self.messages,
            message_end_time=self._scan.last_log_ns,
            message_start_time=self._scan.first_log_ns,
            metadata_count=0,
            schema_count=len(self._scan.schemas),
        ).write(builder)
        Footer(summary_start=self._scan.end + len(data_end), summary_offset_start=0, summary_crc=0).write(
            builder
        )
        return data_end + builder.end() + MAGIC


def sender_of(message: RecordedMessage) -> tuple[str, int]:
    """Robot and incarnation of a recorded message; no name for the base station's own."""
    metadata = message.channel.metadata
    return metadata.get(_ROBOT, ""), int(metadata.get(_INCARNATION, "0"), 16)


def finish(path: Path) -> int:
    """Put an unfinished bag in order so that every reader opens it; returns its number of messages.

    Raises:
        InputError: It does not exist, is not a journal, or is still being written.
    """
    if not path.is_file():
        raise InputError(path, "file", "does not exist", "check the path to the bag")
    journal = Journal(path)
    journal.close()
    return journal.messages


def _locked(path: Path) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        remedy = "choose a folder you can write to"
        raise InputError(path, "writing", error.strerror or str(error), remedy) from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(file)
        problem = "is being written by another base station"
        raise InputError(path, "file", problem, "stop that one or choose another --out") from None
    return file
