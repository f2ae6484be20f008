"""Compiles every kernel the engine launches to machine code for a GPU that need not be there, and runs none.

Prints one line a kernel. ``python -m tests.gpu.compile_kernels 80`` (compute capability 8.0)
"""

import re
import sys
from typing import Any

import torch
import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource
from triton.runtime.jit import JITFunction

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.engine import RayBatch
from mulan.radiance.gpu.triton_engine import TritonEngine
from mulan.radiance.loss import GaussianLikelihoodLoss
from mulan.radiance.optimiser_config import OptimiserConfig
from mulan.radiance.space import SceneSpace

_POINTERS = {torch.float32: "*fp32", torch.bfloat16: "*bf16", torch.int32: "*i32", torch.uint8: "*u8"}
_compiled: set[str] = set()


def compile_instead(self: JITFunction, *args: Any, grid: Any, warmup: bool, **named: Any) -> None:
    """What a launch of this kernel with these arguments would compile."""
    options = {key: named.pop(key) for key in ("num_warps",) if key in named}
    values = {**dict(zip(self.arg_names, args, strict=False)), **named}
    types, constants, aligned = {}, {}, {}
    for position, parameter in enumerate(self.params):
        value = values[parameter.name]
        if parameter.is_constexpr:
            types[parameter.name], constants[parameter.name] = "constexpr", value
        elif isinstance(value, torch.Tensor):
            types[parameter.name] = _POINTERS[value.dtype]
            aligned[(position,)] = [["tt.divisibility", 16]]
        elif isinstance(value, int):
            assert -(2**31) <= value < 2**31, parameter.name
            types[parameter.name] = "i32"
        else:
            types[parameter.name] = "fp32"
    if values.get("WRITE") is False:
        values["counts"].fill_(1)  # so that there are samples to go on with
    key = f"{self.__name__} {types} {constants} {options}"
    if key in _compiled:
        return
    _compiled.add(key)
    source = ASTSource(self, signature=types, constexprs=constants, attrs=aligned)
    target = GPUTarget("cuda", int(sys.argv[1]), 32)
    kernel = triton.compile(source, target=target, options=options)
    assert len(kernel.asm["cubin"]) > 0
    products = len(re.findall(r"\b(?:mma|wgmma\.mma_async)\.sync", kernel.asm["ptx"]))
    print(self.__name__, "matrix instructions:", products, "shared bytes:", kernel.metadata.shared)


def main() -> None:
    """Go once through everything the engine does."""
    JITFunction.run = compile_instead  # type: ignore[method-assign]
    o = torch.randn(64, 3)
    d = torch.nn.functional.normalize(torch.randn(64, 3), dim=-1)
    batch = RayBatch(o, d, torch.rand(64, 3), torch.ones(64), torch.zeros(64, dtype=torch.long))
    for unbounded in (False, True):
        space = SceneSpace((0.0, 0.0, 0.0), 1.0, unbounded)
        field = FieldConfig(log2_table_size=12)
        march, optimiser = MarchConfig(), OptimiserConfig()
        if unbounded:
            march = MarchConfig(cascades=2)
            optimiser = OptimiserConfig(loss=GaussianLikelihoodLoss(), distortion_weight=0.1)
        engine = TritonEngine(field, march, space, True, 0, torch.device("cpu"), optimiser)
        for _ in range(engine.optimiser_config.occupancy_every):
            engine.train_step(batch, 1.0)
        engine.train_step_with_ray_gradients(batch, 1.0)
        engine.ray_gradients(o, d, o)
        engine.render(o, d)
        engine.density(o)


if __name__ == "__main__":
    main()
