"""The outcome of judging one message."""

from dataclasses import dataclass
from enum import Enum
from typing import Any

from mulan.fleet.envelope import Envelope
from mulan.fleet.journal import Entry
from mulan.fleet.refusals import Deferral, Intrusion, LinkStatus, Refusal

GREETING = "_link/greeting"  # keys of what opens a session, keeps it alive and ends it
GOODBYE = "_link/goodbye"


class Arrival(Enum):
    """A message that belongs here."""

    ACCEPTED = 1
    DUPLICATE = 2
    GREETING = 3
    GOODBYE = 4


Outcome = Arrival | LinkStatus | Refusal | Deferral | Intrusion


@dataclass(frozen=True)
class Verdict:
    """What was found.

    Attributes:
        outcome: What to do with it.
        robot: Whose key space it came under, if any.
        envelope: Its envelope; of a session that is not welcome at least who is to be told.
        entry: What is to be written, if accepted.
        message: The decoded message, if accepted.
    """

    outcome: Outcome
    robot: str | None = None
    envelope: Envelope | None = None
    entry: Entry | None = None
    message: Any | None = None
