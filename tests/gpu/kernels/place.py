"""Where the kernels are tested: on a GPU if there is one, else on the CPU in Triton's interpreter."""

import os

import torch

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.gpu.find_gpu import find_gpu
from mulan.radiance.space import SceneSpace

IN_INTERPRETER = os.environ.get("TRITON_INTERPRET") == "1"
ON_GPU = find_gpu()[0] is not None
DEVICE = torch.device("cpu") if IN_INTERPRETER or not ON_GPU else torch.device("cuda")

# two dense levels and two hashed ones; sizes that fill no power of two
FIELD = FieldConfig(
    levels=4,
    log2_table_size=9,
    base_resolution=4,
    finest_resolution=40,
    width=24,
    geometry_features=7,
    harmonics_degree=3,
)
MARCH = MarchConfig(steps=48, occupancy_resolution=16, min_transmittance=1e-2)
BOX = SceneSpace((0.1, 0.0, -0.2), 0.8, False)
WORLD = SceneSpace((0.1, 0.0, -0.2), 0.8, True)


def random(*shape: int, seed: int = 0) -> torch.Tensor:
    """Standard normal numbers on the device under test."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed)).to(DEVICE)


def rays(n: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays from around the scene to points in it."""
    origins = torch.nn.functional.normalize(random(n, 3, seed=seed), dim=-1) * 2
    return origins, torch.nn.functional.normalize(0.3 * random(n, 3, seed=seed + 1) - origins, dim=-1)


def relative_error(got: torch.Tensor, want: torch.Tensor) -> float:
    """Norm of the difference over the norm."""
    return float((got.cpu().double() - want.cpu().double()).norm() / want.cpu().double().norm())
