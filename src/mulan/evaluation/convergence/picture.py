"""Quality against the error a robot starts with."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from mulan.mission.run_folder import write_atomically

_LINES = (("A", "true poses", "#555555"), ("B", "uncorrected", "#c9a66b"), ("ours", "refined", "#0b6e99"))


def draw_convergence(errors: Sequence[dict[str, Any]], path: Path) -> None:
    """PSNR of the setups over the displacement; rings mark attempts of which images were doubted."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6))
    displacement_m = [error["displacement_m"] for error in errors]
    for name, title, colour in _LINES:
        axes.plot(displacement_m, [e["psnr_db"][name] for e in errors], color=colour, label=title)
    for error in errors:
        for row in error["per_seed"]:
            face = "none" if row["doubted"] else "#0b6e99"
            axes.plot(error["displacement_m"], row["psnr_db"]["ours"], "o", mec="#0b6e99", mfc=face, ms=5)
    labels = [f"{e['displacement_m']:g} m\n{e['turn_deg']:g}°" for e in errors]
    axes.set_xticks(displacement_m, labels, fontsize=8)
    axes.set(xlabel="error of the whole robot (hollow: the run doubted images)", ylabel="PSNR [dB]")
    axes.legend(fontsize=8)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=130, bbox_inches="tight"))
    plt.close(figure)
