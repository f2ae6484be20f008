"""Notices when another process writes to the run that is being shown."""

import threading
from collections.abc import Callable
from pathlib import Path

_PERIOD_S = 1.0


class RunWatch:
    """Calls back, in a thread of its own, after any of some files was replaced."""

    def __init__(self, files: dict[Path, Callable[[], None]]) -> None:
        """Watch each file and call its function after it changed; files may not exist yet."""
        self._files = files
        self._seen = {path: _stamp(path) for path in files}
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="run watch", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Watch no more."""
        self._stopped.set()
        self._thread.join(timeout=10)

    def _watch(self) -> None:
        while not self._stopped.wait(_PERIOD_S):
            for path, changed in self._files.items():
                stamp = _stamp(path)
                if stamp is not None and stamp != self._seen[path]:
                    self._seen[path] = stamp
                    changed()


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_ino
