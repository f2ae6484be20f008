"""Copies of a bag with one thing wrong."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from mulan.mission import messages


def spoiled(
    bag: Path,
    topic: str,
    change: Callable[[Any], Any] | None = None,
    raw: Callable[[bytes], bytes] | None = None,
    drop_messages: bool = False,
    drop_topic: bool = False,
    msgtype: str | None = None,
) -> Path:
    """A copy in which one topic's messages are changed (in place), garbled, dropped, or of another type."""
    store = messages.typestore()
    folder = bag.parent / "spoiled"
    with Reader(bag) as reader, Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        copies = {
            c.id: writer.add_connection(
                c.topic, msgtype if msgtype and c.topic == topic else c.msgtype, typestore=store
            )
            for c in reader.connections
            if not (drop_topic and c.topic == topic)
        }
        for connection, time_ns, data in reader.messages():
            if connection.id not in copies:
                continue
            if connection.topic == topic:
                if drop_messages:
                    continue
                if change is not None:
                    message = store.deserialize_cdr(memoryview(bytearray(data)), connection.msgtype)
                    change(message)
                    data = bytes(store.serialize_cdr(message, connection.msgtype))
                data = raw(data) if raw else data
            writer.write(copies[connection.id], time_ns, data)
    return folder / "spoiled.mcap"
