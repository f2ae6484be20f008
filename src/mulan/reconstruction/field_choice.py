"""Sizes of the field for a set of photographs."""

from dataclasses import replace

from mulan.radiance.config import FieldConfig, MarchConfig
from mulan.radiance.optimiser_config import OptimiserConfig

FEW_VIEWS = 12


def choose_field(longest_side: int, views: int, unbounded: bool, on_gpu: bool = False) -> FieldConfig:
    """Grid and network sizes: those that did well on a CPU, or instant-ngp's on a GPU.

    The finest level has about 2.5 cells a pixel across the scene (twice that for an unbounded scene, whose
    inner cube fills half the grid); few views cannot fill fine cells nor tell colour from direction, so
    both shrink.
    """
    few = views <= FEW_VIEWS
    finest = longest_side * (0.8 if few else 2.5) * (2 if unbounded else 1)
    finest = min(max(round(finest / 16) * 16, 64), 2048)
    if on_gpu:
        return FieldConfig(
            levels=16,
            log2_table_size=19,
            finest_resolution=finest,
            width=64,
            harmonics_degree=1 if few else 4,
        )
    log2_table_size = 15 if finest <= 288 else 16 if finest <= 448 else 17
    return FieldConfig(
        levels=8,
        log2_table_size=log2_table_size,
        finest_resolution=finest,
        harmonics_degree=1 if few else 3,
    )


def choose_march(
    longest_side: int, unbounded: bool, quick: bool = False, on_gpu: bool = False
) -> MarchConfig:
    """256 steps for small pictures, 384 for larger ones; on a GPU 1024 and a finer grid.

    Unbounded rays stop at a hundredth of their light, and cells thinner than the thinnest sample that counts
    are skipped: both were compared by ``benchmarks/unbounded.py``. So are those of an object in a quick
    training (:attr:`TrainConfig.quick`), with fewer steps if the pictures are small; a long one would lose
    detail by it (``benchmarks/bounded.py``).
    """
    steps = 1024 if on_gpu else 256 if longest_side <= 160 else 384
    grid = 128 if on_gpu else MarchConfig.occupancy_resolution
    march = MarchConfig(steps=steps, occupancy_resolution=grid)
    if unbounded:
        return replace(march, occupancy_threshold=march.least_opacity, min_transmittance=1e-2)
    if quick and not on_gpu:
        steps = steps * 3 // 4 if longest_side <= 160 else steps
        return MarchConfig(steps=steps, occupancy_threshold=0.03, min_transmittance=1e-3)
    return march


def choose_optimiser(unbounded: bool, quick: bool = False) -> OptimiserConfig:
    """Unbounded scenes pay for weight scattered along their rays, or fog would stay before the cameras.

    A quick training of an object takes larger steps of the table.
    """
    if unbounded:
        return OptimiserConfig(distortion_weight=0.03)
    return OptimiserConfig(table_learning_rate=3e-2 if quick else 2e-2)
