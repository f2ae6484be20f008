import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.native.conftest import build_library

FUZZ = Path(__file__).with_name("fuzz_under_sanitizers.py")


def sanitizer_runtime() -> str | None:
    """The address sanitizer's library, which must be loaded before python's own."""
    try:
        found = subprocess.run(
            ["c++", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return found if Path(found).is_absolute() else None


def test_odd_rays_under_address_and_undefined_behaviour_sanitizers(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    runtime = sanitizer_runtime()
    if not runtime:
        pytest.skip("the compiler has no address sanitizer")
    path = build_library(tmp_path_factory.mktemp("sanitized"), "-DMULAN_SANITIZE=address,undefined")
    environment = os.environ | {
        "LD_PRELOAD": runtime,
        "ASAN_OPTIONS": "detect_leaks=0",  # python's own
        "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1",
    }
    done = subprocess.run(
        [sys.executable, str(FUZZ), str(path)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-4000:]
    assert "clean" in done.stdout
