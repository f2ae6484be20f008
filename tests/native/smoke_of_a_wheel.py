"""Run where a wheel was installed, from any folder: its native engine must load and learn.

python tests/native/smoke_of_a_wheel.py
"""

import sys

import torch

import mulan
from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.kernels.native_library import find_native_library
from mulan.radiance.native_engine import NativeEngine
from mulan.radiance.space import SceneSpace
from mulan.radiance.speed import sphere_batch


def main() -> int:
    library, detail = find_native_library()
    print(f"mulan {mulan.__version__} in {mulan.__path__[0]}, native engine: {detail}")
    if library is None:
        return 1
    field = FieldConfig(levels=4, log2_table_size=12, finest_resolution=64, width=16)
    box = SceneSpace((0.0, 0.0, 0.0), 1.0, False)
    engine = NativeEngine(field, MarchConfig(steps=64), box, True, library=library)
    generator = torch.Generator().manual_seed(0)
    losses = [engine.train_step(sphere_batch(256, generator), 1.0).loss for _ in range(100)]
    print(f"loss {losses[0]:.4f} -> {losses[-1]:.4f}")
    return 0 if losses[-1] < 0.3 * losses[0] else 1


if __name__ == "__main__":
    sys.exit(main())
