"""Sizes of the field; every backend reads the same ones."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class FieldConfig:
    """Multiresolution hash grid and two small networks (Müller et al. 2022)."""

    levels: int = 8
    """Resolutions of the hash grid."""
    log2_table_size: int = 15
    """Entries a level, as a power of two."""
    features: int = 2
    """Features an entry."""
    base_resolution: int = 16
    """Cells a side of the coarsest level."""
    finest_resolution: int = 256
    """Cells a side of the finest level; about 2.5 times the image side wins on a CPU."""
    width: int = 32
    """Neurons in each hidden layer."""
    geometry_features: int = 16
    """Outputs of the density network; the first is the log-density, all of them feed the colour network."""
    harmonics_degree: int = 3
    """Bands of spherical harmonics for the viewing direction (degree d has d² numbers); 1 for few views."""

    def level_resolution(self, level: int) -> int:
        """Cells a side of one level: ``floor(base · b^level)`` with b set by the finest."""
        if self.levels == 1:
            return self.base_resolution
        growth = math.log(self.finest_resolution / self.base_resolution) / (self.levels - 1)
        return math.floor(self.base_resolution * math.exp(level * growth) + 1e-9)

    def level_is_dense(self, level: int) -> bool:
        """Whether every grid corner of a level has an entry of its own (no hashing)."""
        return (self.level_resolution(level) + 1) ** 3 <= 2**self.log2_table_size

    @property
    def encoded_width(self) -> int:
        """Length of the encoding of a point."""
        return self.levels * self.features


MAX_CASCADES = 8


@dataclass(frozen=True)
class MarchConfig:
    """How rays are sampled and composited."""

    steps: int = 256
    """Steps across the diagonal of a bounded scene, or along an unbounded ray."""
    occupancy_resolution: int = 64
    """Cells a side of each occupancy grid; a multiple of 16 where there are several."""
    cascades: int = 1
    """Nested occupancy grids about the scene's centre, each twice as wide as the one inside it; the widest
    covers everything. Two give the inside of an unbounded scene a grid of its own."""
    occupancy_threshold: float = 0.01
    """Cells whose opacity over one step falls below this are skipped."""
    least_opacity: float = 0.02
    """Samples of an unbounded ray thinner than this count as empty once the grid is warm, which leaves more
    time for the rest (nerfacc's ``alpha_thre``); compared by ``benchmarks/unbounded.py``."""
    min_transmittance: float = 1e-4
    """Samples behind this transmittance are dropped."""
    max_samples_per_ray: int = 1024
    """Hard bound on a ray's samples."""

    def __post_init__(self) -> None:
        """Refuse grids that do not nest.

        Raises:
            ValueError: There is no grid, or cells of one would straddle the rim of the one inside it.
        """
        if not 1 <= self.cascades <= MAX_CASCADES:
            raise ValueError(f"cascades must be 1 to {MAX_CASCADES}, not {self.cascades}")
        if self.cascades > 1 and self.occupancy_resolution % 16:
            raise ValueError(
                f"several cascades need an occupancy resolution that is a multiple of 16,"
                f" not {self.occupancy_resolution}"
            )
