"""Few large programs, as the interpreter runs them one after another; several of a kind all the same."""

from mulan.radiance.gpu.launch import BlockSizes, MatrixPrecision, TritonConfig

BLOCKS = BlockSizes(samples=1024, matrix_samples=1024, rays=64, steps=32, matrix_programs=2)
CONFIG = TritonConfig(precision=MatrixPrecision.FP32, room=512, blocks=BLOCKS)
