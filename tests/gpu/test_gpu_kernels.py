"""The kernels without a GPU: run in Triton's interpreter, compiled for machines that are not here.

On a machine with a GPU ``pytest tests/gpu/kernels`` runs the same tests on it.
"""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from mulan.radiance.gpu.find_gpu import find_gpu

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("triton") is None,
    reason="Triton is not installed, so nothing checks the GPU kernels: pip install triton",
)
ROOT = Path(__file__).resolve().parents[2]


def run(*command: str, **environment: str) -> str:
    # Triton decides when it is imported whether to interpret, so it needs a process of its own
    done = subprocess.run(
        [sys.executable, *command],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-4000:]
    return done.stdout


@pytest.mark.skipif(find_gpu()[0] is not None, reason="there is a GPU: the tests run on it")
def test_kernels_are_their_references_in_the_interpreter():
    out = run("-m", "pytest", "-v", "-p", "no:cacheprovider", "tests/gpu/kernels", TRITON_INTERPRET="1")
    passed = re.search(r"(\d+) passed", out)
    assert passed is not None, out
    assert int(passed.group(1)) >= 40


@pytest.mark.parametrize("capability", ["80", "90"])
def test_every_kernel_compiles_for_a_gpu(capability):
    lines = run("-m", "tests.gpu.compile_kernels", capability, TRITON_INTERPRET="0").splitlines()
    products = {line.split()[0]: int(line.split(":")[1].split()[0]) for line in lines}
    assert len(products) == 15
    on_matrix_units = ("density_kernel", "colour_kernel", "colour_backward_kernel", "density_backward_kernel")
    assert all(products[name] > 0 for name in on_matrix_units)
