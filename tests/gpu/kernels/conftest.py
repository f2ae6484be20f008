"""These tests run on a GPU or in Triton's interpreter; ``test_gpu_kernels.py`` starts the latter."""

import pytest

from tests.gpu.kernels.place import IN_INTERPRETER, ON_GPU

collect_ignore_glob = [] if IN_INTERPRETER or ON_GPU else ["test_*.py"]


@pytest.fixture(autouse=True, scope="session")
def _interpreter_multiplies_bf16():
    """The interpreter keeps bf16 as 16-bit integers and forgets to convert them before a matrix product."""
    if not IN_INTERPRETER:
        yield
        return
    import numpy as np
    import triton.language as tl
    from triton.runtime.interpreter import InterpreterBuilder, TensorHandle

    plain = InterpreterBuilder.create_dot

    def widened(handle):
        if handle.dtype.scalar != tl.bfloat16:
            return handle
        return TensorHandle((handle.data.astype(np.uint32) << 16).view(np.float32), tl.float32)

    def create_dot(self, a, b, d, input_precision, max_num_imprecise_acc):
        return plain(self, widened(a), widened(b), d, input_precision, max_num_imprecise_acc)

    InterpreterBuilder.create_dot = create_dot
    yield
    InterpreterBuilder.create_dot = plain
