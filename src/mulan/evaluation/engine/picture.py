"""Quality against training time, ours and the peers', as one picture."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from mulan.mission.run_folder import write_atomically

PANELS = {
    "lego_100": "lego 100×100",
    "lego_200": "lego 200×200",
    "lego_400": "lego 400×400",
    "fox_270x480": "fox 270×480",
}
_OURS = "#0b6e99"


def draw_curves(metrics: dict[str, Any], path: Path) -> None:
    """One panel a measured scene; a dot marks the end of each of our trainings."""
    scenes = [name for name in PANELS if "psnr_curves" in metrics.get(name, {})]
    if not scenes:
        return
    figure, axes = plt.subplots(1, len(scenes), figsize=(4.2 * len(scenes), 3.6), squeeze=False)
    for panel, scene in zip(axes[0], scenes, strict=True):
        _draw_ours(panel, metrics[scene])
        for name, results in metrics.get("peers", {}).items():
            if curve := results.get(scene, {}).get("psnr_curve"):
                panel.plot(*zip(*curve, strict=True), ".-", lw=1, label=name.replace("_", ", "))
        panel.set(xscale="log", xlabel="training time [s]", title=PANELS[scene])
        panel.grid(alpha=0.3)
        panel.legend(loc="center right", fontsize=8)
    axes[0][0].set_ylabel("mean PSNR of held-out views [dB]")
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=130, bbox_inches="tight"))
    plt.close(figure)


def _draw_ours(panel: Axes, measured: dict[str, Any]) -> None:
    for number, curve in enumerate(measured["psnr_curves"].values()):
        panel.plot(*zip(*curve, strict=True), color=_OURS, lw=1.6, label=None if number else "mulan")
        panel.plot(*curve[-1], "o", color=_OURS)
