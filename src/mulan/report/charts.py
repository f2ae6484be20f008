"""A chart as a specification in the page; charts.js draws it in the reader's colours.

The words ``$ink``, ``$muted`` and ``$surface`` stand for colours of the light or dark theme.
"""

import json
import math
from typing import Any

from mulan.report.markup import escape

ROBOT_COLOURS = ("#3b82f6", "#e0690b", "#0d9f6e", "#a855f7", "#e0457b", "#0891b2")
"""Told apart on white and on near-black alike (contrast at least 3 to 1 with both)."""


def colour_of(index: int) -> str:
    """Colour of the n-th robot or setup."""
    return ROBOT_COLOURS[index % len(ROBOT_COLOURS)]


def translucent(colour: str, alpha: float) -> str:
    """A ``#rrggbb`` colour as rgba."""
    r, g, b = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({r},{g},{b},{alpha:g})"


def chart(label: str, data: list[dict[str, Any]], layout: dict[str, Any], height_px: int = 420) -> str:
    """HTML of one chart.

    Args:
        label: What it shows, for readers who cannot see it.
        data: Plotly traces.
        layout: Plotly layout, without theme.
        height_px: Height.
    """
    spec = json.dumps(_plain({"data": data, "layout": layout}), separators=(",", ":"), allow_nan=False)
    # "<" never appears inside the script element, so no text of a file can end it
    safe = spec.replace("<", "\\u003c")
    return (
        f'<div class="chart" role="img" aria-label="{escape(label)}" style="height:{height_px}px">'
        f'<script type="application/json">{safe}</script></div>'
    )


def _plain(value: Any) -> Any:
    """JSON without NaN or infinity (they become gaps), numbers to six digits."""
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
