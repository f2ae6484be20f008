"""Why the base station does not take a message."""

from enum import Enum, IntEnum


class LinkStatus(IntEnum):
    """How the base station sees a robot's session."""

    OPEN = 0
    WRONG_VERSION = 1
    UNKNOWN_ROBOT = 2
    NAME_TAKEN = 3

    @property
    def sentence(self) -> str:
        """What it means and what to do."""
        return _LINK_SENTENCES[self]


class Refusal(IntEnum):
    """What is wrong with one message; sending it again would not help."""

    WRONG_TOPIC = 1
    WRONG_TYPE = 2
    TOO_LARGE = 3
    MALFORMED = 4
    MISTIMED = 5

    @property
    def sentence(self) -> str:
        """What it means."""
        return _REFUSAL_SENTENCES[self]


class Deferral(Enum):
    """Why a message is left unanswered; the same message may be welcome later."""

    TOO_FAST = 1
    TOO_FAR_AHEAD = 2
    CAMERA_UNKNOWN = 3
    DISK_FULL = 4


class Intrusion(Enum):
    """Input that no robot of this mission sends; it is counted and not answered."""

    NO_ENVELOPE = 1
    FOREIGN_KEY = 2
    WRONG_SENDER = 3


_LINK_SENTENCES = {
    LinkStatus.OPEN: "the link is open",
    LinkStatus.WRONG_VERSION: "the base station speaks another protocol version; install one mulan on both",
    LinkStatus.UNKNOWN_ROBOT: "the base station does not know this robot; name it in --ingest.robots there",
    LinkStatus.NAME_TAKEN: "another robot sends under this name; give each robot its own",
}

_REFUSAL_SENTENCES = {
    Refusal.WRONG_TOPIC: "the topic is not one a robot may write",
    Refusal.WRONG_TYPE: "the message type is not the one this topic has",
    Refusal.TOO_LARGE: "the message is larger than the base station takes",
    Refusal.MALFORMED: "the message does not decode, or holds values no sensor gives",
    Refusal.MISTIMED: "the time of the message cannot be right",
}
