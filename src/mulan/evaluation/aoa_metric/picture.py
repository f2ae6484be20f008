"""Error and its variance over the paper's metric and over our spread, an aperture a column."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from mulan.evaluation.aoa_metric.sweep import (
    LAWS,
    AoaMetricConfig,
    ErrorVariance,
    Sweep,
    variance_in_windows,
)
from mulan.mission.run_folder import write_atomically

_OURS, _PAPER = "#0b6e99", "#c0504d"
_LABEL = {ErrorVariance.MEAN_SQUARE: "mean square", ErrorVariance.OF_ABSOLUTE: "of absolute error"}


def draw_metric(
    sweeps: Sequence[Sweep], metrics: dict[str, Any], config: AoaMetricConfig, path: Path
) -> None:
    """Four rows: the paper's two figures, then ours of the same links."""
    figure, axes = plt.subplots(
        4, len(sweeps), figsize=(4 * len(sweeps), 12), squeeze=False, constrained_layout=True
    )
    for column, (sweep, aperture) in enumerate(zip(sweeps, metrics["apertures"], strict=True)):
        rank = aperture["spearman_with_abs_error"]
        rows = (
            ("kappa_paper", sweep.kappa_paper, sweep.peak_error_rad, _PAPER, "kappa_paper", 1.0),
            ("ours", sweep.spread_rad, sweep.error_rad, _OURS, "our claimed RMS error [deg]", 180 / np.pi),
        )
        for number, (name, metric, error, colour, label, scale) in enumerate(rows):
            upper, lower = axes[2 * number][column], axes[2 * number + 1][column]
            upper.scatter(metric * scale, np.degrees(error), s=5, color=colour, alpha=0.5, linewidths=0)
            upper.set(
                xlabel=label,
                ylabel="absolute error [deg]",
                title=f"{100 * sweep.extent_m:.0f} cm, Spearman {rank[name]:.2f}",
            )
            laws = {variance: aperture[law][name] for law, variance in LAWS.items()}
            _draw_variance(lower, metric, error, laws, config, colour, scale)
            lower.set(xlabel=label, ylabel="variance of the error [deg²]")
    for panel in axes.flat:
        panel.grid(alpha=0.3)
        panel.locator_params(axis="x", nbins=5)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=110))
    plt.close(figure)


def _draw_variance(
    panel: Axes,
    metric: Any,
    error: Any,
    laws: dict[ErrorVariance, dict[str, float] | None],
    config: AoaMetricConfig,
    colour: str,
    scale: float,
) -> None:
    """Both readings of the variance and their fits; the mean square is filled."""
    told = []
    for variance, law in laws.items():
        centre, value = variance_in_windows(metric, error, config, variance)
        filled = variance is ErrorVariance.MEAN_SQUARE
        panel.plot(
            centre * scale,
            np.degrees(np.degrees(value)),
            "o",
            ms=3,
            color=colour,
            mfc=colour if filled else "none",
            label=_LABEL[variance],
        )
        if law is None:
            told.append("too few windows to fit")
            continue
        x = np.linspace(centre.min(), centre.max(), 200)
        y = law["factor"] * (x / centre.mean()) ** law["exponent"]
        panel.plot(x * scale, np.degrees(np.degrees(y)), "-" if filled else "--", color="0.3")
        told.append(f"{_LABEL[variance]}: b = {law['exponent']:.2f}, r² = {law['r_squared']:.2f}")
    panel.set_title("\n".join(told), fontsize=8)
    panel.legend(fontsize=7)
