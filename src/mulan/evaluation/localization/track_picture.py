"""Tracks beside their truths, with claimed ellipses."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

from mulan.evaluation.localization.track_score import COVERED, TrackErrors
from mulan.mission.run_folder import write_atomically

_OURS, _TRUE = "#0b6e99", "#b3261e"
_COLUMNS, _ELLIPSES = 4, 30


def draw_tracks(tracks: Sequence[TrackErrors], path: Path) -> None:
    """One panel a track, axes equal; 95 % ellipses at some thirty instants."""
    rows = -(-len(tracks) // _COLUMNS)
    columns = min(len(tracks), _COLUMNS)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4 * columns, 3.8 * rows), squeeze=False, layout="constrained"
    )
    for panel in axes.ravel()[len(tracks) :]:
        panel.set_axis_off()
    for panel, track in zip(axes.ravel(), tracks, strict=False):
        for k in range(0, len(track.time_s), max(1, len(track.time_s) // _ELLIPSES)):
            value, vector = np.linalg.eigh(track.covariance[k, :2, :2])
            width, height = 2 * np.sqrt(COVERED["coverage_95"] * value)
            angle = float(np.degrees(np.arctan2(vector[1, 0], vector[0, 0])))
            claimed = Ellipse(
                track.estimate_m[k], width, height, angle=angle, fill=False, color=_OURS, lw=0.6
            )
            panel.add_patch(claimed)
        panel.plot(*track.true_m.T, color=_TRUE, lw=1.2, label="truth")
        panel.plot(*track.estimate_m.T, ".-", color=_OURS, ms=3, lw=0.6, label="estimate")
        rms = float(np.sqrt((track.off_m**2).mean()))
        panel.set_title(f"{track.name}: RMS {rms:.3f} m", fontsize=9)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set(xlabel="x [m]", ylabel="y [m]")
    axes[0][0].legend(fontsize=8)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=110, bbox_inches="tight"))
    plt.close(figure)
