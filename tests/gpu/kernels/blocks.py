"""Few large programs, as the interpreter runs them one after another; on a GPU, those it is meant to run."""

from mulan.radiance.gpu.launch import BlockSizes, MatrixPrecision, TritonConfig
from tests.gpu.kernels.place import IN_INTERPRETER


def blocks(samples: int, matrix_samples: int, rays: int, steps: int, matrix_programs: int) -> BlockSizes:
    """These in the interpreter; a GPU has no shared memory for matrices of a thousand samples."""
    if not IN_INTERPRETER:
        return BlockSizes()
    return BlockSizes(
        samples=samples,
        matrix_samples=matrix_samples,
        rays=rays,
        steps=steps,
        matrix_programs=matrix_programs,
    )


BLOCKS = blocks(samples=1024, matrix_samples=1024, rays=64, steps=32, matrix_programs=2)
CONFIG = TritonConfig(precision=MatrixPrecision.FP32, room=512, blocks=BLOCKS)
