"""Accuracy, calibration and ranking of scored links as pictures."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mulan.evaluation.aoa.cross_validation import CrossValidation
from mulan.evaluation.aoa.scored_link import ScoredLink
from mulan.mission.run_folder import write_atomically

_OURS, _THEIRS, _GREY = "#0b6e99", "#c8702a", "#888888"
_SET_COLOURS = ("#0b6e99", "#c8702a", "#5b8c3a", "#8b5a9f", "#b03a48", "#6b6b6b")


def _groups(links: Sequence[ScoredLink], *names: str) -> dict[tuple[str, ...], list[ScoredLink]]:
    groups: dict[tuple[str, ...], list[ScoredLink]] = {}
    for link in links:
        groups.setdefault(tuple(getattr(link, name) for name in names), []).append(link)
    return groups


def _save(figure: Figure, path: Path) -> Path:
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=130, bbox_inches="tight"))
    plt.close(figure)
    return path


def _step(panel: Axes, error_deg: Float[NDArray, "n"], colour: str, label: str) -> None:
    order = np.sort(np.abs(error_deg))
    share = np.arange(len(order) + 2).clip(max=len(order)) / len(order)
    text = f"{label}: mean {order.mean():.1f}°, median {np.median(order):.1f}°"
    panel.step(
        [0.01, *np.maximum(order, 0.1), 200], 100 * share, where="post", color=colour, lw=1.8, label=text
    )


def draw_error_distribution(links: Sequence[ScoredLink], path: Path) -> Path:
    """Share of links below each azimuth error, a row a displacement source, a column a set."""
    groups = _groups(links, "source", "set")
    sources, sets = (list(dict.fromkeys(key[i] for key in groups)) for i in (0, 1))
    figure, axes = plt.subplots(
        len(sources),
        len(sets),
        figsize=(4.4 * len(sets), 3.4 * len(sources)),
        squeeze=False,
        sharex=True,
        sharey=True,
        layout="constrained",
    )
    for row, source in enumerate(sources):
        for column, name in enumerate(sets):
            panel, group = axes[row][column], groups.get((source, name), [])
            theirs = [link.reported_error_deg for link in group if link.reported_error_deg is not None]
            if theirs:
                _step(panel, np.array(theirs), _THEIRS, "authors")
            if group:
                _step(panel, np.array([link.error_deg for link in group]), _OURS, "mulan")
            panel.set_title(f"{name}, path by {source} ({len(group)} links)", fontsize=10)
            panel.set_xscale("log")
            panel.set_xlim(0.1, 180)
            panel.set_ylim(0, 101)
            panel.set_xticks([0.1, 0.3, 1, 3, 10, 30, 100], ["0.1", "0.3", "1", "3", "10", "30", "100"])
            panel.minorticks_off()
            panel.grid(alpha=0.3)
            panel.legend(fontsize=8, loc="upper left", framealpha=0.9)
        axes[row][0].set_ylabel("share of links below [%]")
    for panel in axes[-1]:
        panel.set_xlabel("absolute azimuth error [°]")
    return _save(figure, path)


def draw_reliability(links: Sequence[ScoredLink], path: Path) -> Path:
    """Claimed level of the highest-density region against the share of truths it holds."""
    groups = _groups(links, "source", "set")
    sources, sets = (list(dict.fromkeys(key[i] for key in groups)) for i in (0, 1))
    figure, axes = plt.subplots(
        1, len(sources), figsize=(4.8 * len(sources), 4.6), squeeze=False, sharey=True, layout="constrained"
    )
    for panel, source in zip(axes[0], sources, strict=True):
        draw_diagonal(panel)
        for number, name in enumerate(sets):
            if group := groups.get((source, name)):
                draw_levels(
                    panel,
                    np.array([link.level for link in group]),
                    _SET_COLOURS[number % len(_SET_COLOURS)],
                    name,
                )
        panel.set_title(f"path by {source}", fontsize=10)
        panel.legend(fontsize=8, loc="upper left")
    axes[0][0].set_ylabel("truth inside [% of links]")
    return _save(figure, path)


def draw_diagonal(panel: Axes) -> None:
    """Axes of a reliability diagram: the line of honesty, and the bands asked for at 68 and 95 %."""
    panel.plot([0, 100], [0, 100], color=_GREY, lw=1, ls="--")
    for level, low, high in ((68, 60, 76), (95, 90, 98)):
        panel.plot([level, level], [low, high], color="black", lw=5, alpha=0.25, solid_capstyle="butt")
    panel.set(xlim=(0, 100), ylim=(0, 101), xlabel="claimed level of the interval [%]", aspect="equal")
    panel.grid(alpha=0.3)


def draw_levels(panel: Axes, levels: Float[NDArray, "n"], colour: str, label: str) -> None:
    """One curve of a reliability diagram."""
    inside68, inside95 = (100 * float((levels <= level).mean()) for level in (0.68, 0.95))
    order = np.concatenate([[0.0], np.sort(levels), [1.0]])
    share = np.concatenate([np.arange(len(levels) + 1), [len(levels)]]) / len(levels)
    text = f"{label}: {inside68:.0f} % in 68, {inside95:.0f} % in 95"
    panel.step(100 * order, 100 * share, where="post", color=colour, lw=1.6, label=text)


def draw_error_against_sigma(links: Sequence[ScoredLink], path: Path) -> Path:
    """Absolute error over the mixture's sigma; the line is where they are equal."""
    groups = _groups(links, "source", "set")
    sources, sets = (list(dict.fromkeys(key[i] for key in groups)) for i in (0, 1))
    figure, axes = plt.subplots(
        1, len(sources), figsize=(4.8 * len(sources), 4.4), squeeze=False, sharey=True, layout="constrained"
    )
    ticks = [0.1, 0.3, 1, 3, 10, 30, 100]
    sigma = np.array([link.sigma_deg for link in links])
    lowest = min(0.3, float(sigma.min()))
    for panel, source in zip(axes[0], sources, strict=True):
        panel.plot([0.01, 200], [0.01, 200], color=_GREY, lw=1, ls="--", label="error = σ")
        panel.plot([0.01, 200], [0.02, 400], color=_GREY, lw=1, ls=":", label="error = 2 σ")
        for number, name in enumerate(sets):
            if group := groups.get((source, name)):
                panel.scatter(
                    [link.sigma_deg for link in group],
                    [max(abs(link.error_deg), 0.1) for link in group],
                    s=16,
                    alpha=0.75,
                    linewidths=0,
                    color=_SET_COLOURS[number % len(_SET_COLOURS)],
                    label=name,
                )
        panel.set(xscale="log", yscale="log", xlim=(0.8 * lowest, 130), ylim=(0.09, 190))
        panel.set_xticks(ticks, [f"{t:g}" for t in ticks])
        panel.set_yticks(ticks, [f"{t:g}" for t in ticks])
        panel.set_xlim(0.8 * lowest, 130)
        panel.minorticks_off()
        panel.set_title(f"path by {source}", fontsize=10)
        panel.set_xlabel("claimed σ of the mixture about its first direction [°]")
        panel.grid(alpha=0.3)
    axes[0][0].set_ylabel("absolute azimuth error [°]")
    axes[0][0].legend(fontsize=8, loc="upper left")
    return _save(figure, path)


def draw_aoa(links: Sequence[ScoredLink], folder: Path) -> list[Path]:
    """All pictures; none if there are no links."""
    if not links:
        return []
    return [
        draw_error_distribution(links, folder / "errors.png"),
        draw_reliability(links, folder / "reliability.png"),
        draw_error_against_sigma(links, folder / "error_against_sigma.png"),
    ]


def draw_before_and_after(validation: CrossValidation, title: str, path: Path) -> Path:
    """Reliability on held-out places without calibration and with one fitted on the other places."""
    figure, panel = plt.subplots(figsize=(5.2, 5.0), layout="constrained")
    draw_diagonal(panel)
    draw_levels(panel, validation.level_before, _THEIRS, "before")
    draw_levels(panel, validation.level_after, _OURS, "after")
    panel.set_title(
        f"{title}\n{len(validation.place)} links held out by place, "
        f"NLL {validation.nll_before:.2f} → {validation.nll_after:.2f} nats",
        fontsize=9,
    )
    panel.set_ylabel("truth inside [% of links]")
    panel.legend(fontsize=8, loc="upper left")
    return _save(figure, path)
