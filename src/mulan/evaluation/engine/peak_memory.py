"""The most memory this process held since a given moment."""

import resource
import sys
from pathlib import Path

_STATUS, _CLEAR_REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def reset_peak_memory() -> None:
    """Forget earlier peaks, where the system can (Linux, proc(5)); elsewhere the peak is the process's."""
    try:
        _CLEAR_REFS.write_text("5")
    except OSError:
        return


def peak_memory_gb() -> float:
    """Largest resident memory since the last reset [10⁹ bytes], libraries and photographs included."""
    try:
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e9
    except OSError:
        pass
    # kilobytes on Linux, bytes on macOS
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9
