"""How late messages arrived in the course of a soak test, as a picture."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mulan.fleet.soak_arrivals import Arrivals
from mulan.fleet.soak_processes import Member
from mulan.fleet.wire_topics import Importance

_BINS = 120
_SHADES = ("tab:red", "tab:blue", "tab:green", "tab:purple")


def draw_lag(arrived: Arrivals, members: Sequence[Member], path: Path) -> None:
    """Median and largest lag over time by importance; grey where a process was gone."""
    figure, axes = plt.subplots(figsize=(9, 3.2))
    minutes = arrived.arrived_s / 60
    edges = np.linspace(0, max(minutes.max(), 1e-3), _BINS + 1)
    shown = (Importance.COORDINATION, Importance.RADIO, Importance.IMAGE)
    for importance, colour in zip(shown, _SHADES, strict=False):
        of = arrived.importance == importance
        at = np.digitize(minutes[of], edges[1:-1])
        lag_s = arrived.lag_s[of]
        bins = np.unique(at)
        middle = (edges[bins] + edges[bins + 1]) / 2
        name = importance.name.lower()
        axes.plot(middle, [np.median(lag_s[at == b]) for b in bins], color=colour, label=f"{name}, median")
        axes.plot(middle, [lag_s[at == b].max() for b in bins], ":", color=colour, lw=1, label="largest")
    for member in members:
        for begin_s, end_s in member.killed_s:
            shade = "0.6" if member.name == "base" else "0.85"
            axes.axvspan(begin_s / 60, end_s / 60, color=shade, zorder=0)
    axes.set(xlabel="minutes", ylabel="recorded to received [s]", yscale="log")
    axes.legend(fontsize=7, ncols=3)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    plt.close(figure)
