"""ARM64 through an emulator, and another compiler: the same numbers from the same program."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.native.conftest import NATIVE_FOLDER, build_library

SMOKE = Path(__file__).with_name("smoke.c")


def run_smoke(library: Path, compiler: str, folder: Path, *emulator: str) -> dict[str, list[np.ndarray]]:
    """What the smoke program prints, line by line: a name and numbers."""
    program = folder / "smoke"
    paths = ["-I", str(NATIVE_FOLDER / "include"), "-L", str(library.parent), f"-Wl,-rpath,{library.parent}"]
    command = [compiler, "-Wall", "-Werror", "-O1", str(SMOKE), *paths, "-lmulan_native", "-lm"]
    subprocess.run([*command, "-o", str(program)], check=True)
    done = subprocess.run([*emulator, str(program)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    printed: dict[str, list[np.ndarray]] = {}
    for line in done.stdout.splitlines():
        name, *numbers = line.split()
        printed.setdefault(name, []).append(np.array(numbers, np.float64))
    return printed


def assert_same_numbers(got: dict[str, list[np.ndarray]], want: dict[str, list[np.ndarray]]) -> None:
    assert got.keys() == want.keys()
    # learning repeats rounding differences, and a sample on a cell's wall may fall to either side
    tolerance = {"rendered": 2e-2, "losses": 5e-3, "to_origins": 2e-3, "to_directions": 2e-3}
    for name, arrays in want.items():
        for mine, theirs in zip(got[name], arrays, strict=True):
            difference = np.abs(mine - theirs) / (np.abs(theirs) + np.abs(theirs).mean())
            assert np.quantile(difference, 0.99) < tolerance.get(name, 1e-5), name


def have(*programs: str) -> None:
    for program in programs:
        if not shutil.which(program):
            pytest.skip(f"there is no {program}")


def test_arm64_gives_the_numbers_of_this_processor(library, tmp_path: Path) -> None:
    """Debian: apt-get install g++-aarch64-linux-gnu qemu-user-static."""
    have("cc", "aarch64-linux-gnu-g++", "aarch64-linux-gnu-gcc", "qemu-aarch64-static")
    arm = build_library(
        NATIVE_FOLDER.parents[3] / "build" / "native-arm64",
        "-DCMAKE_SYSTEM_NAME=Linux",
        "-DCMAKE_SYSTEM_PROCESSOR=aarch64",
        "-DCMAKE_CXX_COMPILER=aarch64-linux-gnu-g++",
        "-DCMAKE_CXX_FLAGS=-Werror",
    )
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    emulator = ["qemu-aarch64-static", "-L", "/usr/aarch64-linux-gnu"]
    want = run_smoke(library.path, "cc", here)
    assert_same_numbers(run_smoke(arm, "aarch64-linux-gnu-gcc", there, *emulator), want)
