"""What travels beside a message in its Zenoh attachment: 88 bytes, always the same fields."""

import struct
from dataclasses import dataclass

from mulan.fleet.names import LONGEST_NAME_BYTES

MAGIC = b"MULN"
PROTOCOL_VERSION = 1
LARGEST_SEQUENCE = 2**32 - 1  # MCAP counts messages in 32 bits
_HEAD = struct.Struct("<4sH2xQQ")
_BODY = struct.Struct(f"<4sH2xQQII8sqq{LONGEST_NAME_BYTES}s")


class EnvelopeError(ValueError):
    """An attachment that is none of ours."""


@dataclass(frozen=True)
class Envelope:
    """Who sent a message, which one it is, and when.

    Attributes:
        sender: Name of the robot.
        incarnation: Drawn when the robot's spool was made; sequence numbers count within it.
        session: Drawn when the sending process started.
        sequence: From 1 on; 0 marks a greeting, which is acknowledged but not recorded.
        settled_below: The sender waits for no acknowledgement below this number; 0 until it was answered.
        type_hash: First eight bytes of the message type's RIHS01 hash.
        record_ns: When the message was recorded, on the robot's clock.
        sent_ns: When this copy was sent, on the robot's clock.
        version: Of this protocol.
    """

    sender: str
    incarnation: int
    session: int
    sequence: int
    settled_below: int
    type_hash: bytes
    record_ns: int
    sent_ns: int
    version: int = PROTOCOL_VERSION

    def encode(self) -> bytes:
        """As an attachment."""
        return _BODY.pack(
            MAGIC,
            self.version,
            self.incarnation,
            self.session,
            self.sequence,
            self.settled_below,
            self.type_hash,
            self.record_ns,
            self.sent_ns,
            self.sender.encode("ascii"),
        )


def head_of(attachment: bytes) -> Envelope:
    """Version, incarnation and session, which every version keeps at the same place; the rest is left empty.

    Raises:
        EnvelopeError: It is no attachment of this protocol.
    """
    if len(attachment) < _HEAD.size or not attachment.startswith(MAGIC):
        raise EnvelopeError("the attachment is not one of this protocol")
    _, version, incarnation, session = _HEAD.unpack_from(attachment)
    return Envelope("", incarnation, session, 0, 0, bytes(8), 0, 0, version)


def decode(attachment: bytes) -> Envelope:
    """The fields of an attachment of this version.

    Raises:
        EnvelopeError: It is of another length or version, or its name is not plain text.
    """
    if head_of(attachment).version != PROTOCOL_VERSION or len(attachment) != _BODY.size:
        raise EnvelopeError(f"the attachment has {len(attachment)} bytes instead of {_BODY.size}")
    _, version, incarnation, session, sequence, settled, type_hash, record_ns, sent_ns, name = _BODY.unpack(
        attachment
    )
    sender, _, rest = name.partition(b"\0")
    if rest.strip(b"\0") or not sender.isascii():
        raise EnvelopeError("the sender's name is not plain text")
    return Envelope(
        sender.decode("ascii"),
        incarnation,
        session,
        sequence,
        settled,
        type_hash,
        record_ns,
        sent_ns,
        version,
    )
