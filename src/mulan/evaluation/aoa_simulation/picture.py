"""The simulation's figures as one picture."""

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from mulan.mission.run_folder import write_atomically

_OURS, _PAPER = "#0b6e99", "#c0504d"


def draw_simulation(metrics: dict[str, Any], path: Path) -> None:
    """Efficiency, calibration of sigma, echoes and near field, one panel each."""
    figure, axes = plt.subplots(1, 4, figsize=(17, 3.8))
    levels = metrics["efficiency"]
    noise = [level["phase_noise_rad"] for level in levels]
    axes[0].plot(noise, [level["error_over_crb"] for level in levels], "o-", color=_OURS, label="error / CRB")
    axes[0].plot(
        noise, [level["outlier_share"] for level in levels], "s--", color="0.5", label="share of outliers"
    )
    axes[0].axhline(1.10, color=_PAPER, lw=1, label="goal 1.10")
    axes[0].set(xlabel="round-trip phase noise [rad]", ylim=(0, 1.4), title="efficiency, one path")
    octiles = metrics["sigma_octiles"]
    axes[1].axhspan(0.85, 1.15, color=_OURS, alpha=0.12, label="goal ±15 %")
    axes[1].plot(
        [octile["claimed_sigma_deg"] for octile in octiles],
        [octile["empirical_over_claimed"] for octile in octiles],
        "o-",
        color=_OURS,
    )
    axes[1].set(
        xscale="log", xlabel="claimed sigma [deg]", ylim=(0.5, 1.5), title="empirical / claimed sigma"
    )
    echoes = metrics["multipath"]
    names = ["ours", "kappa_paper", "kappa_paper\nno outliers"]
    values = [echoes["nll"], echoes["nll_kappa_paper"], echoes["nll_kappa_paper_no_outlier_mass"]]
    axes[2].bar(names, values, color=[_OURS, _PAPER, _PAPER])
    axes[2].axhline(0, color="0.3", lw=0.8)
    found = 100 * echoes["truth_among_hypotheses"]
    axes[2].set(
        ylabel="held-out NLL [nats], lower is better",
        title=f"1–3 echoes, truth kept in {found:.1f} %",
    )
    close = metrics["near_field"]
    names = ["spherical", "plane wave"]
    values = [close["spherical_median_error_deg"], close["plane_wave_median_error_deg"]]
    axes[3].bar(names, values, color=[_OURS, "0.6"])
    axes[3].axhline(0.15, color=_PAPER, lw=1, label="goal 0.15°")
    axes[3].set(ylabel="median error [deg]", title="paths of 1–1.5 m at 3–10 m")
    for panel in (axes[0], axes[1], axes[3]):
        panel.legend(fontsize=8)
    for panel in axes:
        panel.grid(alpha=0.3)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=130, bbox_inches="tight"))
    plt.close(figure)
