"""What every test folder shares: the recordings' folder and a property-test profile for a shared machine."""

import os
from pathlib import Path

# as the program does, before anything loads torch
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import pytest
from hypothesis import settings

# the machine is shared and its clock says nothing of the code
settings.register_profile("shared-machine", deadline=None, max_examples=60, derandomize=True)
settings.load_profile("shared-machine")


@pytest.fixture
def data() -> Path:
    """The folder of real recordings; tests marked ``data`` are skipped, with a reason, where it is absent."""
    default = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    folder = Path(os.environ.get("MULAN_DATA", default))
    if not folder.is_dir():
        pytest.skip(f"no recordings at {folder}; set MULAN_DATA to the folder that holds them")
    return folder


def pytest_sessionstart() -> None:
    """Find an editable install's library before any test file asks for it while it is collected.

    The library is in site-packages, which the shape checks' import hook hides; what the first question
    answers is remembered.
    """
    import sysconfig

    import mulan.radiance

    installed = str(Path(sysconfig.get_path("platlib")) / "mulan" / "radiance")
    if Path(installed).is_dir() and installed not in mulan.radiance.__path__:
        mulan.radiance.__path__.append(installed)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which engine the tests ran on: without the native one they prove less and take longer."""
    from mulan.radiance.kernels.native_library import find_native_library

    library, reason = find_native_library()
    terminalreporter.write_line(f"native engine: {library.instruction_set if library else reason}")
