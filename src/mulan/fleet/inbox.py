"""What has come from the network and waits for the base station's thread, bounded in bytes."""

import threading
import time
from collections import deque
from dataclasses import dataclass

import zenoh

_OVERHEAD_BYTES = 512  # of the objects around one message


@dataclass(frozen=True)
class Received:
    """One message as it came.

    Attributes:
        key: Zenoh key.
        attachment: Bytes beside it.
        payload: Its bytes; of one that is too large only as many as show that.
        received_ns: When it came, on the system's clock.
    """

    key: str
    attachment: bytes | None
    payload: bytes
    received_ns: int


class Inbox:
    """A queue that drops what does not fit; a robot sends again what is not acknowledged.

    Attributes:
        dropped: How many messages did not fit.
    """

    def __init__(self, capacity_bytes: int, largest_message_bytes: int) -> None:
        self.dropped = 0
        self._capacity, self._largest = capacity_bytes, largest_message_bytes
        self._queue: deque[Received] = deque()
        self._bytes = 0
        self._changed = threading.Condition()

    def receive(self, sample: zenoh.Sample) -> None:
        """Put one sample in; called by Zenoh's threads."""
        received_ns = time.time_ns()
        size = len(sample.payload)
        payload = sample.payload.to_bytes()
        if size > self._largest:
            payload = payload[: self._largest + 1]
        attachment = None if sample.attachment is None else sample.attachment.to_bytes()
        self.put(Received(str(sample.key_expr), attachment, payload, received_ns))

    def put(self, received: Received) -> None:
        """Put one message in, if there is room."""
        size = len(received.payload) + _OVERHEAD_BYTES
        with self._changed:
            if self._bytes + size > self._capacity:
                self.dropped += 1
                return
            self._queue.append(received)
            self._bytes += size
            self._changed.notify()

    def take(self, most: int, timeout_s: float) -> list[Received]:
        """What waits, after at most a time; empty if nothing came."""
        with self._changed:
            if not self._queue:
                self._changed.wait(timeout_s)
            taken = [self._queue.popleft() for _ in range(min(most, len(self._queue)))]
            self._bytes -= sum(len(r.payload) + _OVERHEAD_BYTES for r in taken)
        return taken
