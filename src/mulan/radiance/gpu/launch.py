"""How the kernels are cut into programs, and in which precision they multiply matrices."""

from dataclasses import dataclass, field
from enum import Enum

import torch
import triton.language as tl

from mulan.radiance.kernels.native_grid import NativeGridConfig


class MatrixPrecision(Enum):
    """Operands of the networks' matrix products; sums are float32 always."""

    BF16 = "bf16"
    TF32 = "tf32"
    FP32 = "fp32"

    @property
    def storage(self) -> torch.dtype:
        """Type in which encodings wait for the next kernel."""
        return torch.bfloat16 if self is MatrixPrecision.BF16 else torch.float32

    @property
    def operand(self) -> tl.dtype:
        """Type of the operands."""
        return tl.bfloat16 if self is MatrixPrecision.BF16 else tl.float32

    @property
    def product(self) -> str:
        """Triton's name for how float32 operands are multiplied."""
        return "tf32" if self is MatrixPrecision.TF32 else "ieee"


@dataclass(frozen=True)
class BlockSizes:
    """Work of one program of each kind of kernel; all powers of two."""

    samples: int = 128
    """Samples of a kernel that looks at one at a time."""
    matrix_samples: int = 64
    """Samples of a kernel that multiplies matrices; at least 16."""
    matrix_warps: int = 4
    """Warps of such a kernel's programs."""
    rays: int = 4
    """Rays of a kernel that walks along them..."""
    steps: int = 32
    """...and how many of their steps it sees at once."""
    matrix_programs: int = 512
    """Programs that share the backward pass of the networks; each keeps a gradient of its own."""


@dataclass(frozen=True)
class TritonConfig:
    """How the Triton engine runs."""

    precision: MatrixPrecision = MatrixPrecision.BF16
    """Operands of the networks' matrix products."""
    update_untouched: bool = False
    """Whether table entries without gradient still move by their momentum, as in the reference."""
    wave_samples: int = 2**22
    """Samples in memory at once; batches with more are learnt in several waves."""
    wave_rays: int = 2**17
    """Rays marched at once."""
    room: int = 2**14
    """Arrays of samples are made a multiple of so many long, so that their memory is used again."""
    occupancy: NativeGridConfig = field(default_factory=NativeGridConfig)
    """How the occupancy grid is kept up to date."""
    blocks: BlockSizes = field(default_factory=BlockSizes)
    """How kernels are cut into programs."""


def padded(size: int) -> int:
    """The next power of two, at least the 16 that a matrix product needs."""
    return max(16, 1 << (size - 1).bit_length())


def programs(work: int, share: int) -> int:
    """Programs for so much work."""
    return -(-work // share)
