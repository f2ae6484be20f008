"""An angle-of-arrival profile as a picture: where the power comes from, and what the bearing claims."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.projections.polar import PolarAxes

from mulan.mission.run_folder import write_atomically
from mulan.wireless.azimuth_density import azimuth_mixture
from mulan.wireless.directions import azimuth_elevation
from mulan.wireless.types import AoaProfile, Bearing

_OURS, _TRUTH = "#c8402a", "#1f8a4c"
_FLOOR_DB = -20.0


@dataclass(frozen=True)
class DrawnBearing:
    """A bearing with its profile, and the truth where known.

    Attributes:
        title: What it is.
        bearing: With ``profile``.
        true_azimuth_rad: In the same odometry axes, or None.
    """

    title: str
    bearing: Bearing
    true_azimuth_rad: float | None = None


def draw_profiles(drawn: Sequence[DrawnBearing], path: Path) -> None:
    """Write a PNG, a row a bearing: azimuth around the robot on the left, the full profile on the right."""
    figure = Figure(figsize=(12, 4.3 * len(drawn)), dpi=110, layout="constrained", facecolor="white")
    grid = GridSpec(len(drawn), 2, figure=figure, width_ratios=(1, 1.75))
    for row, entry in enumerate(drawn):
        profile = entry.bearing.profile
        if profile is None:
            raise ValueError("a bearing without its profile cannot be drawn")
        polar = cast(PolarAxes, figure.add_subplot(grid[row, 0], projection="polar"))
        _draw_polar(polar, entry, profile)
        _draw_grid(figure, figure.add_subplot(grid[row, 1]), entry, profile)
    write_atomically(path, lambda temporary: figure.savefig(temporary, format="png"))


def _draw_polar(axes: PolarAxes, entry: DrawnBearing, profile: AoaProfile) -> None:
    strongest = profile.power.max(0)
    closed = np.append(profile.azimuth_rad, profile.azimuth_rad[0] + 2 * np.pi)
    axes.fill(closed, np.append(strongest, strongest[0]) / strongest.max(), color="#0b6e99", alpha=0.25, lw=0)
    axes.plot(closed, np.append(strongest, strongest[0]) / strongest.max(), color="#0b6e99", lw=1)
    mixture = azimuth_mixture(entry.bearing)
    for level, radius, width in ((0.95, 1.08, 3), (0.68, 1.08, 7)):
        for number, (begin, end) in enumerate(mixture.interval(level)):
            arc = np.linspace(begin, end, max(2, int((end - begin) / 0.01)))
            label = f"{level:.0%} interval" if number == 0 else None
            axes.plot(
                arc,
                np.full_like(arc, radius),
                color=_OURS,
                lw=width,
                alpha=0.45 if level > 0.7 else 0.9,
                solid_capstyle="butt",
                label=label,
            )
    for number, azimuth in enumerate(mixture.mean_rad):
        weight = mixture.weight[number]
        axes.plot([azimuth, azimuth], [0, 1.02], color=_OURS, lw=0.6 + 1.6 * float(weight))
        axes.annotate(str(number + 1), (azimuth, 1.25), color=_OURS, ha="center", va="center", fontsize=9)
    if entry.true_azimuth_rad is not None:
        axes.plot([entry.true_azimuth_rad] * 2, [0, 1.16], color=_TRUTH, lw=1.8, ls="--", label="truth")
    axes.set_ylim(0, 1.18)
    axes.set_yticks([])
    axes.grid(alpha=0.3)
    axes.tick_params(pad=12)
    axes.set_title(entry.title, fontsize=10, pad=14)
    axes.legend(fontsize=8, loc="lower left", bbox_to_anchor=(-0.28, -0.12))


def _draw_grid(figure: Figure, axes: Axes, entry: DrawnBearing, profile: AoaProfile) -> None:
    decibel = 10 * np.log10(np.maximum(profile.power / profile.power.max(), 1e-9))
    shown = axes.pcolormesh(
        np.degrees(profile.azimuth_rad),
        np.degrees(profile.elevation_rad),
        decibel,
        vmin=_FLOOR_DB,
        vmax=0,
        cmap="viridis",
        shading="nearest",
        rasterized=True,
    )
    azimuth, elevation = azimuth_elevation(entry.bearing.direction_odom)
    for number, (a, e) in enumerate(zip(np.degrees(azimuth), np.degrees(elevation), strict=True)):
        axes.plot(a, e, "o", ms=9, mfc="none", mec="white", mew=1.6)
        axes.annotate(str(number + 1), (a, e), (7, 5), textcoords="offset points", color="white", fontsize=10)
    if entry.true_azimuth_rad is not None:
        axes.axvline(float(np.degrees(entry.true_azimuth_rad)), color="white", lw=1.4, ls="--")
        axes.annotate(
            "truth",
            (float(np.degrees(entry.true_azimuth_rad)), -84),
            (4, 0),
            textcoords="offset points",
            color="white",
            fontsize=9,
        )
    axes.set(xlim=(-180, 180), ylim=(-90, 90), xlabel="azimuth [°]", ylabel="elevation [°]")
    axes.set_xticks(range(-180, 181, 60))
    axes.set_yticks(range(-90, 91, 30))
    figure.colorbar(shown, ax=axes, label="power below the peak [dB]", pad=0.01)
