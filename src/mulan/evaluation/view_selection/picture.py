"""The comparison as a picture: quality against the number of views, and the gain over the references."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from mulan.evaluation.view_selection.policies import FARTHEST, OURS, RANDOM
from mulan.evaluation.view_selection.summary import REFERENCES
from mulan.mission.run_folder import write_atomically

_COLOURS = {OURS: "#0b6e99", RANDOM: "#777777", FARTHEST: "#c9772b"}
_OTHERS = ("#8e6bbf", "#4e9a51", "#c25b6e", "#a0863d", "#5b8fc2", "#b06fa8", "#6d8f8a", "#d39a9a", "#777733")


def draw(metrics: dict[str, Any], titles: Mapping[str, str], path: Path, counted: str = "views") -> None:
    """Write the picture as PNG.

    Args:
        metrics: See :func:`mulan.evaluation.view_selection.summary.summarise`.
        titles: Of the policies.
        path: Target.
        counted: What the numbers count.
    """
    policies = metrics["policies"]
    if not policies:
        return
    counts = list(next(iter(policies.values()))["views"])
    colours = dict(zip((n for n in policies if n not in _COLOURS), _OTHERS * 2, strict=False)) | _COLOURS
    figure = Figure(figsize=(11, 1.6 + 0.36 * len(policies) + 2), dpi=130, layout="constrained")
    curve, bars = figure.subplots(1, 2, width_ratios=(1, 1.2))
    for name, policy in policies.items():
        mean = [policy["views"][c]["psnr_db"]["mean"] for c in counts]
        width = 2.6 if name == OURS else 1.3
        curve.plot(range(len(counts)), mean, "o-", ms=4, lw=width, color=colours[name], label=titles[name])
    curve.set_xticks(range(len(counts)), counts)
    curve.set(xlabel=counted, ylabel="mean PSNR of the test views [dB]")
    curve.grid(alpha=0.25)
    curve.legend(fontsize=7, frameon=False)
    reference = next((name for name in REFERENCES if name in policies), RANDOM)
    rows = [name for name in policies if name != reference]
    last = counts[-2:] if len(counts) > 1 else counts
    for k, count in enumerate(last):
        for row, name in enumerate(rows):
            gain = policies[name]["views"][count]["minus"].get(reference)
            if gain is None:
                continue
            at = row + 0.3 * (k - (len(last) - 1) / 2)
            error = 0.0 if gain["low"] is None else gain["mean"] - gain["low"]
            marker = "os"[k % 2]
            bars.errorbar(gain["mean"], at, xerr=error, fmt=marker, ms=5, capsize=3, color=colours[name])
    bars.axvline(0, color="#555", lw=0.8)
    bars.set_yticks(np.arange(len(rows)), [titles[name] for name in rows], fontsize=8)
    marks = ", ".join(f"{'circle' if k == 0 else 'square'} {count} {counted}" for k, count in enumerate(last))
    bars.set(xlabel=f"PSNR above {titles[reference]} [dB],\npaired, with 95 % interval", title=marks)
    bars.title.set_fontsize(9)
    bars.grid(alpha=0.25, axis="x")
    write_atomically(path, lambda temporary: figure.savefig(temporary, format="png"))
