"""``mulan doctor``: what this machine has, and what each missing part costs."""

import logging
import os
import platform
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import tyro
from rich.table import Table

from mulan.cli.progress import console


@dataclass(frozen=True)
class Options:
    """Say what this machine has and what a missing part costs."""


@dataclass(frozen=True)
class Finding:
    """One line of the diagnosis.

    Attributes:
        part: What was looked for.
        present: Whether it is there; None where it is just a fact.
        detail: What was found, or what its absence costs and how to get it.
    """

    part: str
    present: bool | None
    detail: str


def _library(name: str, purpose: str) -> Finding:
    try:
        return Finding(name, True, f"{version(name)} ({purpose})")
    except PackageNotFoundError:
        return Finding(name, False, f"{purpose} will fail; get it with 'pip install {name}'")


def _gpu() -> Finding:
    from mulan.radiance.gpu.find_gpu import find_gpu

    gpu, detail = find_gpu()
    return Finding("GPU", None if gpu is None else True, detail if gpu else f"none to use: {detail}")


def _engine() -> Finding:
    from mulan.radiance.gpu.find_gpu import find_gpu
    from mulan.radiance.kernels.native_library import find_native_library

    if find_gpu()[0] is not None:
        return Finding("engine", None, "fields are learnt on the GPU, in Triton")
    native = find_native_library()[0] is not None
    return Finding("engine", None, f"fields are learnt on the CPU, in {'C++' if native else 'torch'}")


def _native_engine() -> Finding:
    import torch

    from mulan.radiance.backend import WITHOUT_NATIVE
    from mulan.radiance.kernels.native_library import find_native_library

    library, detail = find_native_library()
    if library is None:
        return Finding("native engine", False, f"{detail}: {WITHOUT_NATIVE}")
    threads = f"{library.instruction_set} instructions, {torch.get_num_threads()} threads"
    return Finding("native engine", True, f"{threads}, {library.path}")


def _speed() -> Finding:
    from mulan.radiance.speed import measure_training_speed

    # the findings have a line on a missing engine; its warning would break the table
    log = logging.getLogger("mulan.radiance.backend")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        speed = measure_training_speed()
    finally:
        log.setLevel(level)
    rate = f"{speed.samples_per_s / 1e6:.2f} M samples/s, {speed.rays_per_s / 1e3:.3g} k rays/s"
    return Finding("speed", None, f"{rate} in a second of training on a built-in scene")


def _memory_gib() -> float:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    except (ValueError, OSError):
        return float("nan")


def _browser() -> Finding:
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if path := shutil.which(name):
            return Finding("browser", True, f"{path} (tests look at the report with it)")
    return Finding("browser", False, "the browser tests are skipped; on Debian 'apt-get install chromium'")


def _data() -> Finding:
    folder = Path(os.environ.get("MULAN_DATA", "../shared/data"))
    if folder.is_dir():
        return Finding("MULAN_DATA", True, str(folder.resolve()))
    return Finding(
        "MULAN_DATA",
        False,
        "the published experiments cannot be rerun (the demo can); set it to the data folder",
    )


def diagnose() -> list[Finding]:
    """All findings, facts first."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)
    free_gib = shutil.disk_usage(".").free / 2**30
    machine = f"{platform.system()} {platform.machine()}, {cores} cores, {_memory_gib():.0f} GiB"
    findings = [
        Finding("Python", sys.version_info >= (3, 11), platform.python_version()),
        Finding("machine", None, machine),
        Finding("disk", free_gib > 1, f"{free_gib:.0f} GiB free here; a run takes about 0.1 GiB"),
        _gpu(),
        _library("torch", "the radiance field"),
        _native_engine(),
        _engine(),
        _speed(),
        _library("gtsam", "localization"),
        _library("mitsuba", "photographs of simulated scenes"),
        _library("rosbags", "reading and writing bags"),
        _browser(),
        _data(),
    ]
    return findings


def main(arguments: Sequence[str]) -> int:
    """Print the diagnosis; exit code 1 when something needed is missing."""
    tyro.cli(Options, args=arguments, prog="mulan doctor")
    marks = {True: "[green]✓[/]", False: "[yellow]✗[/]", None: "[dim]·[/]"}
    table = Table(box=None, show_header=False, padding=(0, 1))
    table.add_column()
    table.add_column()
    table.add_column(overflow="fold")
    findings = diagnose()
    for finding in findings:
        table.add_row(marks[finding.present], finding.part, finding.detail)
    console.print(table)
    needed = {"Python", "torch", "gtsam", "mitsuba", "rosbags"}
    return 1 if any(f.part in needed and f.present is False for f in findings) else 0
