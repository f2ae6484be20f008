import os
import platform
import shutil
import subprocess
from pathlib import Path

import pytest

import mulan.radiance.native_engine
from mulan.radiance.kernels.native_library import NativeLibrary

REPOSITORY = Path(__file__).resolve().parents[2]
NATIVE_FOLDER = Path(mulan.radiance.native_engine.__file__).with_name("native")


def build_library(folder: Path, *options: str) -> Path:
    """The library built by cmake in a folder, as a user without the package's own build would."""
    if not shutil.which("cmake") or not (shutil.which("c++") or shutil.which("g++")):
        pytest.skip("building libmulan_native needs cmake and a C++ compiler")
    for command in (
        ["cmake", "-S", str(NATIVE_FOLDER), "-B", str(folder), *options],
        ["cmake", "--build", str(folder), "--parallel", "2"],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    return next(folder.glob("libmulan_native.*"))


@pytest.fixture(scope="session")
def library() -> NativeLibrary:
    """Built from the sources as they are now, not as they were when the package was installed.

    MULAN_TEST_LIBRARY names another build, as 'make sanitize' does.
    """
    if given := os.environ.get("MULAN_TEST_LIBRARY"):
        return NativeLibrary(Path(given))
    # processes that share the tests build each their own
    process = os.environ.get("PYTEST_XDIST_WORKER", "")
    return NativeLibrary(build_library(REPOSITORY / "build" / f"native{process}"))


X86 = platform.machine().lower() in ("x86_64", "amd64")
BUILDS = ["x86-64-v4", "x86-64-v3", "x86-64"] if X86 else ["generic"]  # widest first


@pytest.fixture(params=BUILDS)
def build(library: NativeLibrary, request: pytest.FixtureRequest):
    """The library with each of its builds in turn."""
    before = library.instruction_set
    if not library.use_instruction_set(request.param):
        pytest.skip(f"this processor cannot run the {request.param} build")
    yield library
    library.use_instruction_set(before)
