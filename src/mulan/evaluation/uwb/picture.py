"""Errors with fitted densities, reliability, and the trial with gross outliers, as pictures."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from mulan.evaluation.uwb.protocol import Split
from mulan.evaluation.uwb.rejection import GROSS_M, REJECT_ABOVE, reject
from mulan.evaluation.uwb.score import join, link_numbers
from mulan.mission.run_folder import write_atomically
from mulan.wireless.range_model import RangeModel
from mulan.wireless.recordings.uwb_samples import RangeSamples

_COLOUR = {"calibrated": "#0b6e99", "gaussian": "#d98324", "plain": "#7b4ea3", "constant": "#6b7a3a"}
_TICKS_M = (-0.2, 0, 0.2, 0.5, 1, 2, 5)
_LABEL = {
    "calibrated": "calibrated mixture",
    "gaussian": "Gaussian, fitted bias",
    "plain": "zero bias, reported σ (10 cm where none)",
    "constant": "zero bias, 10 cm",
}


def _save(figure: Figure, path: Path) -> None:
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120, bbox_inches="tight"))
    plt.close(figure)


def draw_errors(sets: dict[str, list[Split]], path: Path) -> None:
    """Held-out errors of each set beside the mean of the densities claimed for them."""
    figure, axes = plt.subplots(1, len(sets), figsize=(5 * len(sets), 3.8), squeeze=False)
    grid = np.linspace(-1, 2, 301)
    for panel, (name, splits) in zip(axes[0], sets.items(), strict=True):
        errors = np.concatenate([split.scored.samples.error_m for split in splits])
        panel.hist(errors, np.linspace(-1, 2, 151), density=True, color="#cfd8dc", label="held-out errors")
        density, gauss = np.zeros(len(grid)), np.zeros(len(grid))
        for split in splits:
            share = len(split.scored.samples.link) / len(errors)
            numbers = link_numbers(split.model, split.scored.samples)
            for number, count in zip(*np.unique(numbers, return_counts=True), strict=True):
                at = np.full(len(grid), split.model.reference_m)
                of_link = np.full(len(grid), number)
                part = share * count / len(numbers)
                density += part * np.exp(split.model.log_density(of_link, grid + at, at))
            train = split.train.error_m
            gauss += share * np.exp(-0.5 * ((grid - train.mean()) / train.std()) ** 2) / train.std() / 2.5066
        panel.plot(grid, density, color=_COLOUR["calibrated"], label="calibrated mixture")
        panel.plot(grid, gauss, color=_COLOUR["gaussian"], label="one Gaussian")
        panel.set(yscale="log", ylim=(1e-4, 20), xlabel="measured − true [m]", title=name)
        panel.legend(fontsize=8)
    axes[0][0].set_ylabel("density [1/m]")
    _save(figure, path)


def draw_reliability(sets: dict[str, list[Split]], path: Path) -> None:
    """Share of held-out ranges inside each claimed region; the diagonal is right."""
    figure, axes = plt.subplots(1, len(sets), figsize=(4.2 * len(sets), 4), squeeze=False)
    claimed = np.linspace(0, 1, 101)
    for panel, (name, splits) in zip(axes[0], sets.items(), strict=True):
        _, level = join([split.scored for split in splits])
        panel.plot([0, 1], [0, 1], color="black", lw=0.8)
        for model, values in level.items():
            style = "--" if model == "constant" else "-"
            held = np.searchsorted(np.sort(values), claimed, side="right") / len(values)
            panel.plot(claimed, held, style, color=_COLOUR[model], label=_LABEL[model])
        panel.axvspan(0.675, 0.685, ymin=0.60, ymax=0.76, color="#88bb88", lw=0)
        panel.axvspan(0.945, 0.955, ymin=0.90, ymax=0.98, color="#88bb88", lw=0)
        panel.set(xlabel="claimed mass", title=name, xlim=(0, 1), ylim=(0, 1), aspect="equal")
    axes[0][0].set_ylabel("share of held-out ranges inside")
    axes[0][-1].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.02, 1))
    _save(figure, path)


def draw_outliers(
    model: RangeModel, samples: RangeSamples, others: Sequence[RangeSamples], path: Path
) -> None:
    """Errors of every antenna pair over time, rejected ones marked, for the pair with gross outliers."""
    shown = [samples, *others]
    figure, axes = plt.subplots(
        len(shown), 1, figsize=(9, 2.8 * len(shown)), sharex=True, sharey=True, squeeze=False
    )
    for panel, part in zip(axes[:, 0], shown, strict=True):
        out = reject(model, part) > REJECT_ABOVE
        panel.plot(part.time_s[~out], part.error_m[~out], ".", ms=3, color="#0b6e99", label="kept")
        panel.plot(part.time_s[out], part.error_m[out], "x", ms=4, color="#b3261e", label="rejected")
        panel.axhline(GROSS_M, color="black", lw=0.6, ls=":")
        panel.set(ylabel="measured − true [m]", title=f"trial and agents {part.name}")
        panel.set_yscale("symlog", linthresh=0.5, linscale=2)
        panel.set_yticks(_TICKS_M, [f"{tick:g}" for tick in _TICKS_M])
        panel.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    axes[-1, 0].set_xlabel("time [s]")
    _save(figure, path)
