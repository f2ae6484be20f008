"""When, where and with what a figure was measured."""

import os
import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any


def _processor() -> str:
    try:
        with open("/proc/cpuinfo") as lines:
            return next(
                (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown"
            )
    except OSError:
        return platform.processor() or "unknown"


def provenance(seed: int) -> dict[str, Any]:
    """Date, machine, versions and seed, for the JSON beside a result."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "machine": f"{platform.machine()}, {_processor()}, {cores} cores",
        "python": platform.python_version(),
        "torch": version("torch"),
        "mulan": version("mulan"),
        "seed": seed,
    }
