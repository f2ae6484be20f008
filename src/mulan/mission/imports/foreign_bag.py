"""A ROS 1 or ROS 2 bag of any kind, read topic by topic."""

import difflib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from mulan.errors import InputError
from mulan.mission import bag_topics, messages

BAG_SUFFIXES = (".bag", ".mcap", ".db3")
_MOST_NAMED = 30  # topics of the bag that a sentence lists


@dataclass(frozen=True)
class TopicSummary:
    """One topic of a bag.

    Attributes:
        name: Its name.
        msgtype: Its message type in ROS 2 spelling; "" where several share the name.
        count: Messages.
    """

    name: str
    msgtype: str
    count: int


@dataclass(frozen=True)
class Recorded:
    """One message.

    Attributes:
        topic: Where it was.
        msgtype: Its type in ROS 2 spelling.
        record_ns: When it was recorded, on the recorder's clock.
        message: The message.
    """

    topic: str
    msgtype: str
    record_ns: int
    message: Any


class ForeignBag:
    """An open bag.

    Attributes:
        path: The file or folder.
        topics: What it holds, sorted by name.
    """

    def __init__(self, path: Path, reader: AnyReader) -> None:
        self.path = path
        self._reader = reader
        self.topics = tuple(
            TopicSummary(name, info.msgtype or "", info.msgcount)
            for name, info in sorted(reader.topics.items())
        )

    @property
    def start_s(self) -> float:
        """When recording began."""
        return self._reader.start_time / 1e9

    def topic(self, name: str, accepts: Collection[str], wanted_by: str) -> TopicSummary:
        """One topic, seen to be there, to hold messages, and to be of a type that can be used.

        Args:
            name: The topic.
            accepts: Message types.
            wanted_by: Who asks, for the sentence.

        Raises:
            InputError: It is absent (the nearest names and what the bag holds are told), empty, or of another
                type.
        """
        found = {topic.name: topic for topic in self.topics}
        field = f"topic {name}"
        if name not in found:
            near = difflib.get_close_matches(name, found, 3, 0.5)
            same = [topic.name for topic in self.topics if topic.msgtype in accepts]
            listed = [f"{topic.name} ({_short(topic.msgtype)})" for topic in self.topics[:_MOST_NAMED]]
            more = f" and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
            likely = near or same
            hint = f"did you mean {' or '.join(likely[:3])}? " if likely else ""
            raise InputError(
                self.path,
                field,
                f"is absent, wanted as {wanted_by}; {hint}"
                f"the bag holds {', '.join(listed) or 'nothing'}{more}",
                "correct the topic map",
            )
        topic = found[name]
        if topic.msgtype not in accepts:
            words = " or ".join(dict.fromkeys(map(_short, accepts)))
            raise InputError(
                self.path,
                field,
                f"is of type {_short(topic.msgtype) or 'several types'}, {wanted_by} is made from {words}",
                "name another topic in the topic map",
            )
        if topic.count == 0:
            raise InputError(self.path, field, "has no messages", f"record it, or take it out of {wanted_by}")
        return topic

    def messages(self, names: Collection[str]) -> Iterator[Recorded]:
        """Messages of some topics in the order they were recorded, one at a time.

        Raises:
            InputError: The bag is damaged or a message does not decode.
        """
        wanted = [connection for connection in self._reader.connections if connection.topic in names]
        if not wanted:
            return  # an empty list would mean all of them to rosbags
        for connection, record_ns, data in self._reader.messages(wanted):
            try:
                message = self._reader.deserialize(data, connection.msgtype)
            except Exception as error:  # generated code: short data surfaces as whatever the reader raises
                raise InputError(
                    self.path,
                    f"topic {connection.topic}",
                    f"a message does not decode ({str(error) or type(error).__name__})",
                    "record the topic again",
                ) from error
            yield Recorded(connection.topic, connection.msgtype, record_ns, message)


@contextmanager
def open_bag(path: Path) -> Iterator[ForeignBag]:
    """Open a ROS 1 ``.bag``, an ``.mcap``, a ``.db3``, or the folder ``ros2 bag record`` makes.

    Raises:
        InputError: It is missing, of another kind, cut short or damaged.
    """
    if not path.exists():
        raise InputError(path, "file", "does not exist", "check the path to the bag")
    if path.suffix == ".mcap" or (path.is_dir()):
        bag_topics.check_file(path)
    elif path.suffix not in BAG_SUFFIXES:
        raise InputError(path, "file", "is no bag", "name a .bag, .mcap or .db3 file or a rosbag2 folder")
    try:
        with AnyReader([path], default_typestore=messages.typestore()) as reader:
            yield ForeignBag(path, reader)
    except InputError:
        raise
    except Exception as error:  # rosbags lets whatever damaged bytes cause through
        raise InputError(
            path,
            "bag",
            f"cannot be read ({str(error).splitlines()[0] if str(error) else type(error).__name__})",
            "repair it with 'rosbag reindex', 'ros2 bag reindex' or 'mcap recover', or record it again",
        ) from error


def _short(msgtype: str) -> str:
    """A type as people write it."""
    return msgtype.replace("/msg/", "/")
