"""The shape checks' import hook and the order of imports must not hide the engine from the tests."""

import subprocess
import sys

from mulan.radiance.kernels.native_library import find_native_library

WHILE_COLLECTED = find_native_library()[0] is not None


def test_the_suite_finds_the_engine_that_a_user_finds() -> None:
    program = (
        "import mulan.radiance.kernels.native_library as n; print(n.find_native_library()[0] is not None)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(WHILE_COLLECTED) == str(find_native_library()[0] is not None)
