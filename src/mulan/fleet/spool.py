"""A robot's messages on disk until the base station has them."""

import fcntl
import os
import secrets
import sqlite3
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mulan.errors import InputError
from mulan.fleet.refusals import Refusal
from mulan.fleet.wire_topics import Importance

_SCHEMA = """
CREATE TABLE IF NOT EXISTS waiting (
    sequence INTEGER PRIMARY KEY, importance INTEGER, suffix TEXT, record_ns INTEGER, payload BLOB
);
CREATE INDEX IF NOT EXISTS by_importance ON waiting (importance, sequence);
CREATE TABLE IF NOT EXISTS state (name TEXT PRIMARY KEY, value INTEGER);
"""


@dataclass(frozen=True)
class Unsent:
    """A message to be kept.

    Attributes:
        importance: How urgently it is sent.
        suffix: Of its topic.
        record_ns: When it was recorded, on the robot's clock.
        payload: CDR bytes.
    """

    importance: Importance
    suffix: str
    record_ns: int
    payload: bytes


@dataclass(frozen=True)
class Spooled:
    """A message that waits.

    Attributes:
        sequence: Its number.
        importance: How urgently it is sent.
        suffix: Of its topic.
        record_ns: When it was recorded, on the robot's clock.
        payload: CDR bytes.
    """

    sequence: int
    importance: Importance
    suffix: str
    record_ns: int
    payload: bytes


class Spool:
    """One SQLite file; what ``add`` has returned for outlives the process. Several threads may use it.

    When it is full the oldest of the least important messages go; ``dropped`` counts them.

    Attributes:
        path: The file.
        incarnation: Drawn when the file was made.
        dropped: Messages given up for want of room since the file was made, by importance.
    """

    def __init__(self, path: Path, capacity_bytes: int) -> None:
        """Open or make the file.

        Raises:
            InputError: It cannot be written, is damaged, or another process uses it.
        """
        self.path = path
        self._capacity = capacity_bytes
        self._lock = threading.RLock()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._guard = os.open(path.with_name(f"{path.name}.lock"), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC)
        except OSError as error:
            remedy = "choose a folder you can write to"
            raise InputError(path, "writing", error.strerror or str(error), remedy) from error
        try:
            fcntl.flock(self._guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._guard)
            remedy = "stop that one or choose another --spool"
            raise InputError(path, "file", "is used by another robot process", remedy) from None
        try:
            self._db = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=NORMAL")
            self._db.executescript(_SCHEMA)
            self.incarnation = self._state("incarnation") or self._draw()
            self._bytes = self._one("SELECT SUM(LENGTH(payload)) FROM waiting") or 0
        except sqlite3.Error as error:
            os.close(self._guard)
            raise InputError(path, "spool", str(error), "free some space, or delete it if damaged") from error
        self.dropped: Counter[Importance] = Counter(
            {i: count for i in Importance if (count := self._state(f"dropped {i.name}") or 0)}
        )
        self._floor = self._find_floor()

    @property
    def settled_below(self) -> int:
        """Number of the oldest message that waits; of the next one if none does."""
        return self._floor

    @property
    def last_sequence(self) -> int:
        """Number of the newest message ever added."""
        with self._lock:
            return self._state("last") or 0

    @property
    def position(self) -> int:
        """What the last ``add`` said of where its source stands; 0 before any."""
        with self._lock:
            return self._state("position") or 0

    @property
    def refused(self) -> int:
        """Messages the base station refused since the file was made."""
        with self._lock:
            return self._state("refused") or 0

    @property
    def waiting_bytes(self) -> int:
        """Payloads that wait."""
        return self._bytes

    def __len__(self) -> int:
        with self._lock:
            return self._one("SELECT COUNT(*) FROM waiting") or 0

    def add(
        self, importance: Importance, suffix: str, record_ns: int, payload: bytes, position: int = 0
    ) -> int:
        """Keep a message; returns its number.

        Args:
            importance: How urgently it is sent.
            suffix: Of its topic.
            record_ns: When it was recorded, on the robot's clock.
            payload: CDR bytes.
            position: Where its source stands after it, kept in the same transaction.

        Raises:
            OSError: The disk is full.
        """
        return self.add_all([Unsent(importance, suffix, record_ns, payload)], position)

    def add_all(self, unsent: Sequence[Unsent], position: int = 0) -> int:
        """Keep several messages, all or none; returns the number of the last.

        Raises:
            OSError: The disk is full.
        """
        with self._lock:
            sequence, before = self._state("last") or 0, (self._bytes, self.dropped.copy(), self._floor)
            try:
                self._db.execute("BEGIN IMMEDIATE")
                for message in unsent:
                    sequence += 1
                    self._make_room(len(message.payload))
                    row = (
                        sequence,
                        int(message.importance),
                        message.suffix,
                        message.record_ns,
                        message.payload,
                    )
                    self._db.execute("INSERT INTO waiting VALUES (?, ?, ?, ?, ?)", row)
                    self._bytes += len(message.payload)
                self._set("last", sequence)
                if position:
                    self._set("position", position)
                self._db.execute("COMMIT")
            except sqlite3.Error as error:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                self._bytes, self.dropped, self._floor = before
                raise OSError(str(error)) from error
            return sequence

    def note(self, name: str, value: int) -> None:
        """Keep a number beside the messages, for whoever fills the spool."""
        with self._lock:
            self._set(f"note {name}", value)

    def noted(self, name: str) -> int | None:
        """A number kept by ``note``."""
        with self._lock:
            return self._state(f"note {name}")

    def next_of(self, importance: Importance, after: int, most: int) -> list[Spooled]:
        """The oldest messages of one importance after a number."""
        with self._lock:
            rows = self._db.execute(
                "SELECT sequence, importance, suffix, record_ns, payload FROM waiting"
                " WHERE importance = ? AND sequence > ? ORDER BY sequence LIMIT ?",
                (int(importance), after, most),
            ).fetchall()
        return [Spooled(n, Importance(i), suffix, t, payload) for n, i, suffix, t, payload in rows]

    def settle(
        self, through: int, beyond: Sequence[tuple[int, int]], refused: Sequence[tuple[int, Refusal]]
    ) -> tuple[int, list[tuple[int, Refusal]]]:
        """Let go of what the base station has; returns how many it stored and which it refused."""
        with self._lock:
            self._db.execute("BEGIN IMMEDIATE")
            new: list[tuple[int, Refusal]] = []
            for sequence, why in refused:
                if self._delete(sequence, sequence):
                    new.append((sequence, why))
            stored = sum(self._delete(first, last) for first, last in ((0, through), *beyond))
            if new:
                self._set("refused", self.refused + len(new))
            self._db.execute("COMMIT")
            if stored or new:
                self._floor = self._find_floor()
        return stored, new

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            self._db.close()
            os.close(self._guard)

    def _delete(self, first: int, last: int) -> int:
        size, count = self._db.execute(
            "SELECT COALESCE(SUM(LENGTH(payload)), 0), COUNT(*) FROM waiting WHERE sequence BETWEEN ? AND ?",
            (first, last),
        ).fetchone()
        if count:
            self._db.execute("DELETE FROM waiting WHERE sequence BETWEEN ? AND ?", (first, last))
            self._bytes -= size
        return count

    def _make_room(self, size: int) -> None:
        while self._bytes + size > self._capacity:
            row = self._db.execute(
                "SELECT sequence, importance, LENGTH(payload) FROM waiting"
                " ORDER BY importance DESC, sequence LIMIT 1"
            ).fetchone()
            if row is None:
                return
            self._db.execute("DELETE FROM waiting WHERE sequence = ?", (row[0],))
            self._bytes -= row[2]
            self.dropped[Importance(row[1])] += 1
            self._set(f"dropped {Importance(row[1]).name}", self.dropped[Importance(row[1])])
            self._floor = self._find_floor()

    def _find_floor(self) -> int:
        oldest = self._one("SELECT MIN(sequence) FROM waiting")
        return (self._state("last") or 0) + 1 if oldest is None else oldest

    def _draw(self) -> int:
        incarnation = secrets.randbits(63) | 1
        self._set("incarnation", incarnation)
        return incarnation

    def _one(self, query: str) -> int | None:
        return self._db.execute(query).fetchone()[0]

    def _state(self, name: str) -> int | None:
        row = self._db.execute("SELECT value FROM state WHERE name = ?", (name,)).fetchone()
        return None if row is None else int(row[0])

    def _set(self, name: str, value: int) -> None:
        self._db.execute("INSERT OR REPLACE INTO state VALUES (?, ?)", (name, value))
