"""How much memory a process may still take."""

import os
from pathlib import Path

_CGROUP = Path("/sys/fs/cgroup")


def available_bytes() -> int:
    """Memory free for new data: the machine's, or less where the control group sets a limit (Linux)."""
    machine = _meminfo_available()
    if machine is None:
        pages = os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 2**19
        machine = pages * (os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096)
    limit, used = _number(_CGROUP / "memory.max"), _number(_CGROUP / "memory.current")
    return machine if limit is None or used is None else min(machine, max(limit - used, 0))


def _meminfo_available() -> int | None:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return None


def _number(path: Path) -> int | None:
    try:
        text = path.read_text().strip()
    except OSError:
        return None
    return int(text) if text.isdigit() else None
