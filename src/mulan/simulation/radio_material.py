"""What the things of a scene are made of, as radio meets them (names and laws of ITU-R P.2040)."""

import re
from enum import Enum


class RadioMaterial(Enum):
    """A slab of one make; its value names the law of ITU-R P.2040 for permittivity and conductivity."""

    CONCRETE = "concrete"
    BRICK = "brick"
    PLASTERBOARD = "plasterboard"
    WOOD = "wood"
    CHIPBOARD = "chipboard"
    PLYWOOD = "plywood"
    GLASS = "glass"
    CEILING_BOARD = "ceiling_board"
    MARBLE = "marble"
    METAL = "metal"
    GROUND = "medium_dry_ground"

    @property
    def thickness_m(self) -> float:
        """Of the slab; the waves between its two faces are part of how much it reflects and lets through."""
        return _THICKNESS_M[self]


_THICKNESS_M = {
    RadioMaterial.CONCRETE: 0.2,
    RadioMaterial.BRICK: 0.12,
    RadioMaterial.PLASTERBOARD: 0.025,
    RadioMaterial.WOOD: 0.02,
    RadioMaterial.CHIPBOARD: 0.02,
    RadioMaterial.PLYWOOD: 0.015,
    RadioMaterial.GLASS: 0.006,
    RadioMaterial.CEILING_BOARD: 0.015,
    RadioMaterial.MARBLE: 0.03,
    RadioMaterial.METAL: 0.002,
    RadioMaterial.GROUND: 1.0,
}

# None leaves the thing out: it hardly reflects
_WORDS: tuple[tuple[str, RadioMaterial | None], ...] = (
    ("leaf leaves foliage crown bush rug carpet curtain", None),
    ("frame bar sill skirting door crate shelf table book card bench fence trunk globe", RadioMaterial.WOOD),
    ("wood wooden oak walnut parquet boards", RadioMaterial.WOOD),
    ("hull deck belly wheel rocker hinge wing mast head dish generator steel iron", RadioMaterial.METAL),
    ("aluminium aluminum copper", RadioMaterial.METAL),
    ("window pane lens iris", RadioMaterial.GLASS),
    ("mandelbrot planet chart poster picture sign banner", RadioMaterial.WOOD),
    ("brick bricks shed pot basin column", RadioMaterial.BRICK),
    ("lawn grass soil earth water", RadioMaterial.GROUND),
)
_BY_WORD = {word: made_of for words, made_of in _WORDS for word in words.split()}
_BY_NAME = {material.value: material for material in RadioMaterial}


def radio_material(names: tuple[str, ...], surface: str) -> RadioMaterial | None:
    """What a thing is made of, by what its author called it.

    First a name of ITU-R P.2040 in any of the names, as ``itu_wood`` or ``mat-concrete``; then the last word
    of a name that this module knows, as in ``crate_2`` (wood); then metal for Mitsuba's conductors and glass
    for its dielectrics; concrete for all else.

    Args:
        names: Of the shape and of its surface, the one that counts more first.
        surface: Mitsuba's description of that surface, which names its classes.

    Returns:
        The material, or None for what hardly reflects: foliage, cloth.
    """
    for name in names:
        for itu_name, material in _BY_NAME.items():
            if itu_name in name.lower():
                return material
    for name in names:
        for word in reversed(re.split(r"[^a-z]+", name.lower())):
            if word in _BY_WORD:
                return _BY_WORD[word]
    if "conductor" in surface.lower():
        return RadioMaterial.METAL
    if "dielectric" in surface.lower():
        return RadioMaterial.GLASS
    return RadioMaterial.CONCRETE
