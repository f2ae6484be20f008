"""The table as a picture: PSNR of every setup, and one held-out view with its errors."""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from mulan.mission.pixels import load_resized
from mulan.mission.run_folder import RunFolder, write_atomically

_COLOURS = {"A": "#555555", "ours": "#0b6e99", "ours_weights": "#6db3d1"}
_OTHER = "#c9a66b"
_TITLE_LETTERS = 24  # a line above a picture
_ERROR_SCALE = 0.3  # absolute colour error shown brightest


def draw_bars(metrics: dict[str, Any], titles: Mapping[str, str], path: Path) -> None:
    """PSNR with one standard deviation over the seeds; hollow marks are aligned."""
    setups = metrics["setups"]
    if not setups:
        return
    figure, axes = plt.subplots(figsize=(7.2, 0.5 * len(setups) + 1.2))
    names = list(setups)
    mean = np.array([setups[name]["psnr_db"]["mean"] for name in names])
    deviation = [setups[name]["psnr_db"]["std"] or 0.0 for name in names]
    rows = np.arange(len(names))[::-1]
    axes.barh(rows, mean, xerr=deviation, color=[_COLOURS.get(n, _OTHER) for n in names], capsize=3)
    aligned = [setups[name]["aligned_psnr_db"] for name in names]
    axes.plot(aligned, rows, "o", mfc="none", mec="black", ms=5, label="aligned")
    for row, value in zip(rows, mean, strict=True):
        axes.text(value - 0.15, row, f"{value:.2f}", va="center", ha="right", color="white", fontsize=8)
    axes.set_yticks(rows, [titles[name] for name in names], fontsize=8)
    axes.set(xlabel="mean PSNR of held-out views [dB]", xlim=(max(mean.min() - 4, 0), None))
    axes.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    _save(figure, path)


def draw_views(runs: Mapping[str, RunFolder], titles: Mapping[str, str], path: Path) -> None:
    """The same view as every setup renders it, above its absolute error; the photograph stands first."""
    kept = [len(list(run.renders.glob("*_rendered.png"))) for run in runs.values()]
    view = (min(kept, default=0) - 1) // 2
    shown = {n: r for n, r in runs.items() if _picture(r, view, "rendered").exists()}
    if not shown:
        return
    true = _load(_picture(next(iter(shown.values())), view, "true"))
    figure, axes = plt.subplots(2, len(shown) + 1, figsize=(2.2 * (len(shown) + 1), 4.6), squeeze=False)
    for axis in axes.flat:
        axis.axis("off")
    axes[0][0].imshow(true)
    axes[0][0].set_title("photograph", fontsize=8)
    for column, (name, run) in enumerate(shown.items(), start=1):
        rendered = _load(_picture(run, view, "rendered"))
        error = np.abs(rendered - true).mean(-1)
        axes[0][column].imshow(rendered)
        axes[0][column].set_title(textwrap.fill(titles[name], _TITLE_LETTERS), fontsize=8)
        axes[1][column].imshow(error, cmap="magma", vmin=0, vmax=_ERROR_SCALE)
        psnr = -10 * np.log10(max(float(((rendered - true) ** 2).mean()), 1e-10))
        axes[1][column].set_title(f"{psnr:.1f} dB", fontsize=8)
    _save(figure, path)


def _picture(run: RunFolder, view: int, kind: str) -> Path:
    return run.renders / f"{view:03d}_{kind}.png"


def _load(path: Path) -> Any:
    return load_resized(path, None)[..., :3].clip(0, 1)


def _save(figure: Any, path: Path) -> None:
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=130, bbox_inches="tight"))
    plt.close(figure)
