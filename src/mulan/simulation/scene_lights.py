"""Lamps and skies of the built-in worlds."""

from mulan.simulation.mitsuba_parts import Node, panel, place, plain

Tone = tuple[float, float, float]


def glow(radiance: float, tone: Tone) -> Node:
    """An area emitter."""
    return {"type": "area", "radiance": {"type": "rgb", "value": [radiance * part for part in tone]}}


def lamp(
    position_m: Tone, size_m: tuple[float, float], radiance: float, tone: Tone = (1.0, 1.0, 1.0)
) -> Node:
    """A panel that shines downwards."""
    part = panel(place(position_m, pitch_deg=180.0), size_m, plain((0.0, 0.0, 0.0)))
    part["emitter"] = glow(radiance, tone)
    return part


def sky(radiance: float, tone: Tone) -> Node:
    """Even light from everywhere, also what is seen above the horizon."""
    return {"type": "constant", "radiance": {"type": "rgb", "value": [radiance * part for part in tone]}}


def sun(direction: Tone, irradiance: float, tone: Tone) -> Node:
    """Parallel light that travels along a direction."""
    value = [irradiance * part for part in tone]
    return {
        "type": "directional",
        "direction": list(direction),
        "irradiance": {"type": "rgb", "value": value},
    }
