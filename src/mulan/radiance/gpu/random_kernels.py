"""Random numbers as a function of what they are for, the same as the native engine's."""

from typing import no_type_check

import triton
import triton.language as tl

# what a number is drawn for
JITTER, CELL_X, EXPLORING = 0, 1, 4  # the three axes of a cell one after another


def split_seed(seed: int) -> tuple[int, int]:
    """The low and the high half of a 64-bit seed as signed 32-bit numbers, the type kernels take."""
    return tuple((half ^ 2**31) - 2**31 for half in (seed & 0xFFFFFFFF, seed >> 32))  # type: ignore[return-value]


@triton.jit
@no_type_check
def mix(x):
    """``lowbias32`` (Wellons, "Prospecting for hash functions", 2018)."""
    x = x ^ (x >> 16)
    x = x * 0x7FEB352D
    x = x ^ (x >> 15)
    x = x * 0x846CA68B
    return x ^ (x >> 16)


@triton.jit
@no_type_check
def uniform(low, high, index, dimension):
    """A number in [0, 1) for each index."""
    inner = mix(high.to(tl.uint32) ^ mix(tl.zeros_like(index).to(tl.uint32) + dimension))
    hashed = mix(index.to(tl.uint32) ^ mix(low.to(tl.uint32) ^ inner))
    return (hashed >> 8).to(tl.float32) * (1.0 / 16777216.0)
