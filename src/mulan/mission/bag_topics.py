"""The messages of a bag, decoded and sorted by header stamp, topic by topic."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from mulan.errors import InputError
from mulan.mission import messages, ros_stamps

_MAGIC = b"\x89MCAP0\r\n"
_UNSTAMPED = (messages.ROBOTS, messages.TF_STATIC)


@dataclass(frozen=True)
class BagTopics:
    """What a bag holds of the topics asked for.

    Attributes:
        source: The bag.
        messages: Decoded messages by topic, in order of their header stamps; topics without messages have an
            empty list.
    """

    source: Path
    messages: Mapping[str, list[Any]]

    def has(self, topic: str) -> bool:
        """Whether the bag has a topic, even an empty one."""
        return topic in self.messages

    def of(self, topic: str) -> list[Any]:
        """Messages of a topic; none if it is absent."""
        return self.messages.get(topic, [])

    def error(self, topic: str, problem: str, remedy: str) -> InputError:
        """The sentence for something wrong in a topic."""
        return InputError(self.source, f"topic {topic}", problem, remedy)


def topic_names(path: Path) -> list[str]:
    """Every topic in a bag, sorted.

    Raises:
        InputError: As :func:`load`.
    """
    check_file(path)
    with _BagReading(path), Reader(path) as reader:
        return sorted({connection.topic for connection in reader.connections})


def load(path: Path, types: Mapping[str, str]) -> BagTopics:
    """Decode the topics a mission is made of.

    Args:
        path: An ``.mcap`` file, or the folder ``ros2 bag record`` makes.
        types: Message type each wanted topic must have; others are ignored.

    Raises:
        InputError: The bag is missing, not MCAP, cut short or damaged, a topic has another type than it
            should, or a message does not decode.
    """
    check_file(path)
    found: dict[str, list[Any]] = {}
    with _BagReading(path), Reader(path) as reader:
        wanted = [connection for connection in reader.connections if connection.topic in types]
        for connection in wanted:
            _check_type(connection, types[connection.topic], path)
            found.setdefault(connection.topic, [])
        # an empty list would mean all of them to rosbags
        for connection, _, data in reader.messages(wanted) if wanted else ():
            found[connection.topic].append(_decode(connection, data, path))
    for topic, decoded in found.items():
        if topic not in _UNSTAMPED:
            decoded.sort(key=ros_stamps.stamp_s)
    return BagTopics(path, found)


def check_file(path: Path) -> None:
    """See that a path is a whole MCAP file or a bag folder.

    Raises:
        InputError: It is missing, is not MCAP, or was cut short.
    """
    if not path.exists():
        raise InputError(path, "file", "does not exist", "check the path to the bag")
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise InputError(
                path, "folder", "is no ROS 2 bag (no metadata.yaml)", "name the .mcap file instead"
            )
        return
    remedy = "record it with 'ros2 bag record --storage mcap'"
    if path.suffix != ".mcap":
        raise InputError(path, "file", "is not named .mcap", remedy)
    try:
        with path.open("rb") as file:
            head = file.read(len(_MAGIC))
            file.seek(max(0, path.stat().st_size - len(_MAGIC)))
            tail = file.read()
    except OSError as error:
        raise InputError(path, "file", error.strerror or str(error), "check that you may read it") from error
    if not head or not _MAGIC.startswith(head):
        raise InputError(path, "file", "is not an MCAP file", remedy)
    if tail != _MAGIC or path.stat().st_size < 2 * len(_MAGIC):
        raise InputError(
            path, "end of file", "is missing, the recording was cut short", "repair it with 'mcap recover'"
        )


class _BagReading:
    """Turns whatever rosbags raises on damaged bytes into one sentence."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        # rosbags lets struct, zstd, assertion and index errors through on damaged bytes
        if isinstance(error, Exception) and not isinstance(error, InputError):
            raise InputError(
                self.path,
                "MCAP records",
                f"cannot be read ({str(error) or type(error).__name__})",
                "repair it with 'mcap recover' or record it again",
            ) from error


def _check_type(connection: Connection, msgtype: str, path: Path) -> None:
    if connection.msgtype != msgtype:
        raise InputError(
            path,
            f"topic {connection.topic}",
            f"has type {connection.msgtype} instead of {msgtype}",
            "record that type or rename the topic",
        )


def _decode(connection: Connection, data: bytes, path: Path) -> Any:
    try:
        return messages.typestore().deserialize_cdr(data, connection.msgtype)
    except Exception as error:  # generated code: short data surfaces as whatever the field's reader raises
        raise InputError(
            path,
            f"topic {connection.topic}",
            f"a message does not decode ({error})",
            "record the topic again",
        ) from error
