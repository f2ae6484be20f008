"""Placed WSR runs: estimates, truths and claimed ellipses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from mulan.mission.run_folder import write_atomically

if TYPE_CHECKING:
    from mulan.evaluation.localization.real_wsr_position import PlacedRun

_OURS, _TRUE = "#0b6e99", "#b3261e"


def draw_positions(runs: Sequence[PlacedRun], path: Path) -> None:
    """A row a displacement source, a column a set; 68 % ellipses, a line from each estimate to its truth."""
    sets = list(dict.fromkeys(run.set for run in runs))
    sources = list(dict.fromkeys(run.source for run in runs))
    figure, axes = plt.subplots(
        len(sources),
        len(sets),
        figsize=(4.2 * len(sets), 4 * len(sources)),
        squeeze=False,
        layout="constrained",
    )
    for row, source in enumerate(sources):
        for column, name in enumerate(sets):
            panel = axes[row][column]
            group = [run for run in runs if run.set == name and run.source is source]
            for run in group:
                value, vector = np.linalg.eigh(run.ellipse_68_m2)
                width, height = 2 * np.sqrt(value)
                angle = float(np.degrees(np.arctan2(vector[1, 0], vector[0, 0])))
                at = (float(run.estimate_m[0]), float(run.estimate_m[1]))
                claimed = Ellipse(at, width, height, angle=angle, fill=False, color=_OURS, lw=0.5)
                claimed.set_alpha(0.4)
                panel.add_patch(claimed)
                panel.plot(*np.array([run.estimate_m, run.true_m]).T, color="#999999", lw=0.6)
                panel.plot(*run.estimate_m, ".", color=_OURS, ms=5)
                panel.plot(*run.true_m, "+", color=_TRUE, ms=7)
            median = np.median([run.error_m for run in group]) if group else np.nan
            panel.set_title(f"{name}, path by {source.value}: median {median:.2f} m", fontsize=9)
            panel.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", xlim=(-4, 4), ylim=(-4, 4))
            panel.grid(alpha=0.3)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120, bbox_inches="tight"))
    plt.close(figure)
