"""What the base station answers: what it holds, what it refused, and its clock."""

import struct
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from mulan.fleet.envelope import MAGIC, PROTOCOL_VERSION, EnvelopeError
from mulan.fleet.refusals import LinkStatus, Refusal

MOST_RANGES = 128
MOST_REFUSED = 128
NOT_TIMED_NS = 0  # the robot's clock in an answer that is said again
_HEAD = struct.Struct("<4sHHQQQqqqIHH")
_RANGE = struct.Struct("<II")
_REFUSED = struct.Struct("<IH")


@dataclass(frozen=True)
class Acknowledgement:
    """One answer to one session.

    Attributes:
        status: Whether the session is welcome.
        base: Drawn when the base station's process started.
        incarnation, session: Of the robot it is meant for.
        sent_ns: The robot's clock in the message it answers; ``NOT_TIMED_NS`` if it was answered before.
        received_ns, answered_ns: The base station's clock when that came and when this left.
        through: Everything up to this number is on the base station's disk (or was refused).
        beyond: Ranges (first, last) after the first gap that are too.
        refused: Numbers refused since the last answer, with the reason.
    """

    status: LinkStatus
    base: int
    incarnation: int
    session: int
    sent_ns: int
    received_ns: int
    answered_ns: int
    through: int = 0
    beyond: Sequence[tuple[int, int]] = ()
    refused: Sequence[tuple[int, Refusal]] = ()

    def encode(self) -> bytes:
        """As a payload; what does not fit is left to later answers."""
        beyond, refused = self.beyond[:MOST_RANGES], self.refused[:MOST_REFUSED]
        head = _HEAD.pack(
            MAGIC,
            PROTOCOL_VERSION,
            self.status,
            self.base,
            self.incarnation,
            self.session,
            self.sent_ns,
            self.received_ns,
            self.answered_ns,
            self.through,
            len(beyond),
            len(refused),
        )
        return b"".join(
            [head, *(_RANGE.pack(*r) for r in beyond), *(_REFUSED.pack(n, why) for n, why in refused)]
        )


def worth_telling(beyond: Sequence[tuple[int, int]], recent: Collection[int]) -> Sequence[tuple[int, int]]:
    """As many ranges as one answer holds: of too many the first ones, and what came last.

    Over a link that loses nearly everything gaps are many, and what a robot does not know yet lies anywhere.
    """
    if len(beyond) <= MOST_RANGES:
        return beyond
    latest = sorted(recent)[-MOST_RANGES // 2 :]
    first = beyond[: MOST_RANGES - len(latest)]
    return [*first, *((n, n) for n in latest if n > first[-1][1])]


def decode(payload: bytes) -> Acknowledgement:
    """The fields of an answer.

    Raises:
        EnvelopeError: It is of another version, length, or holds a status or reason nobody knows.
    """
    if len(payload) < _HEAD.size or not payload.startswith(MAGIC):
        raise EnvelopeError("the answer is not one of this protocol")
    _, version, status, base, incarnation, session, sent, received, answered, through, ranges, refusals = (
        _HEAD.unpack_from(payload)
    )
    if version != PROTOCOL_VERSION:
        # whatever else it says, the two cannot talk
        return Acknowledgement(LinkStatus.WRONG_VERSION, base, incarnation, session, sent, received, answered)
    middle = _HEAD.size + ranges * _RANGE.size
    if len(payload) != middle + refusals * _REFUSED.size:
        raise EnvelopeError("the answer was cut short")
    try:
        refused = [(n, Refusal(why)) for n, why in _REFUSED.iter_unpack(payload[middle:])]
        found = LinkStatus(status)
    except ValueError as error:
        raise EnvelopeError(str(error)) from error
    beyond = tuple(_RANGE.iter_unpack(payload[_HEAD.size : middle]))
    return Acknowledgement(
        found, base, incarnation, session, sent, received, answered, through, beyond, refused
    )
