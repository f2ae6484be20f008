"""Flights and their relative errors over time as one picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from mulan.evaluation.localization.relative_score import RelativeErrors
from mulan.mission.run_folder import write_atomically

if TYPE_CHECKING:
    from mulan.evaluation.localization.real_euroc import Team

_COLOURS = ("#0b6e99", "#c8702a", "#5b8c3a")
_SCHEMES = (("ours", "-"), ("odometry, best alignment to truth", ":"), ("one initial fix (paper)", "--"))


def draw_flights(
    team: Team,
    ours: Sequence[RelativeErrors],
    paper: Sequence[RelativeErrors],
    aligned: Sequence[RelativeErrors],
    path: Path,
) -> None:
    """Paths from above, and the error of one robot's position in another's axes over time."""
    figure, (above, panel) = plt.subplots(
        1, 2, figsize=(12, 4.4), layout="constrained", width_ratios=(1, 1.6)
    )
    for colour, (name, flight) in zip(_COLOURS, team.flights.items(), strict=False):
        at = flight.truth.T_world_body[::20, :3, 3]
        above.plot(at[:, 0], at[:, 1], color=colour, lw=1, label=name)
    above.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="true paths from above")
    above.legend(fontsize=8)
    for (label, style), scheme in zip(_SCHEMES, (ours, aligned, paper), strict=True):
        for colour, errors in zip(_COLOURS, scheme, strict=False):
            text = f"{' – '.join(errors.pair)}, {label}"
            off = np.linalg.norm(errors.off_m, axis=1)
            panel.plot(errors.time_s, off, style, color=colour, lw=1.2, label=text)
    panel.set(yscale="log", xlabel="time [s]", ylabel="relative position error [m]")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=6.5, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14))
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=120, bbox_inches="tight"))
    plt.close(figure)
