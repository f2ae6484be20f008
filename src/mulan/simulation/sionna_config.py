"""How rays are traced by Sionna RT."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SionnaConfig:
    """Paths of radio among the things of a scene, traced by Sionna RT."""

    max_depth: int = 3
    """Most reflections and passages through things a path may have."""
    rays: int = 10_000
    """Rays sent from an antenna to find paths; small or far things need more."""
    refraction: bool = True
    """Whether radio passes through things, weakened by what they are made of."""
    diffraction: bool = False
    """Whether radio bends around edges, once a path; takes half as long again."""
    cell_m: float = 0.03
    """Side of the cells within which positions of the moving antenna share their paths. Lengths are carried
    from the cell's middle to each position as from a mirror image, so phases stay exact; strength and
    visibility do not change within a cell."""
