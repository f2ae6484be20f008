"""The simulated cases as pictures: errors beside bounds, calibration, one fleet with its ellipses."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from mulan.evaluation.localization.simulated_team import Case, Noise
from mulan.evaluation.localization.trials import draw, told
from mulan.geometry import se3
from mulan.localization.localize import localize_from_measurements
from mulan.mission.run_folder import write_atomically

_OURS, _GOAL = "#0b6e99", "#c0504d"
_STYLES = {
    "pairs": ("exact odometry", "#0b6e99", "o-"),
    "outliers": ("20 % outliers", "#c0504d", "s-"),
    "drift": ("drifting odometry", "#6a994e", "^-"),
}
_SIGMAS_95 = 2.4477468  # square root of the 95 % quantile of chi-squared with two degrees of freedom
_EXAGGERATION = 5


def _of(cases: Mapping[str, Mapping[str, Any]], kind: str, suffix: str = "") -> list[Mapping[str, Any]]:
    """Cases of a kind whose estimator answered, in the order of the results."""
    return [
        case
        for name, case in cases.items()
        if name.startswith(f"{kind}_")
        and name.endswith("_drift") == bool(suffix)
        and case["rms_m"] is not None
    ]


def draw_cases(cases: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """RMS and bound against the number of meetings and of robots, and NEES of every case."""
    figure, axes = plt.subplots(1, 3, figsize=(15, 4.2))
    for kind, (label, colour, style) in _STYLES.items():
        found = _of(cases, kind)
        meetings = [case["meetings"] for case in found]
        axes[0].loglog(meetings, [case["rms_m"] for case in found], style, color=colour, label=label)
        axes[0].loglog(meetings, [case["bound_m"] for case in found], "--", color=colour, lw=1)
        axes[2].errorbar(
            meetings,
            [case["nees_per_dof"] for case in found],
            [2 * case["nees_per_dof_standard_error"] for case in found],
            fmt=style,
            color=colour,
            label=label,
        )
    axes[0].set(xlabel="places at which both measure", ylabel="camera RMS [m]", title="two robots")
    for suffix, label, colour, style in (
        ("", "exact odometry", "#0b6e99", "o-"),
        ("_drift", "drifting odometry", "#6a994e", "^-"),
    ):
        found = _of(cases, "robots", suffix)
        robots = [case["robots"] for case in found]
        axes[1].loglog(robots, [case["rms_m"] for case in found], style, color=colour, label=label)
        axes[1].loglog(robots, [case["bound_m"] for case in found], "--", color=colour, lw=1)
    axes[1].set(xlabel="robots", ylabel="camera RMS [m]", title="fleets, five places a pair in reach")
    axes[2].axhspan(0.8, 1.25, color=_OURS, alpha=0.1, label="goal")
    axes[2].axhline(1.0, color="0.4", lw=0.8)
    axes[2].set(
        xscale="log",
        xlabel="places at which both measure",
        ylim=(0, 2),
        title="NEES per freedom, two robots (±2 standard errors)",
    )
    counts = sorted({case["robots"] for case in cases.values() if case["robots"] > 2})
    axes[1].set_xticks(counts, [str(count) for count in counts])
    axes[1].set_xticks([], minor=True)
    for panel in axes[:2]:
        panel.plot([], [], "--", color="0.4", lw=1, label="Cramér–Rao bound")
    for panel in axes:
        panel.legend(fontsize=8)
        panel.grid(alpha=0.3, which="both")
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=130, bbox_inches="tight"))
    plt.close(figure)


def _ellipse(centre_m: Float[NDArray, "2"], covariance_m2: Float[NDArray, "2 2"]) -> Float[NDArray, "p 2"]:
    angle = np.linspace(0, 2 * np.pi, 60)
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    return centre_m + _EXAGGERATION * _SIGMAS_95 * circle @ np.linalg.cholesky(covariance_m2).T


def draw_example(noise: Noise, seed: int, path: Path) -> None:
    """One drifting fleet of five: true and estimated paths, who measured whom, 95 % ellipses."""
    case = Case("example", 1, robots=5, drifting=True, samples=41)
    team = draw(case, noise, seed, 0)
    found = localize_from_measurements(team.robots, team.bearings, team.ranges, told(case))
    T_world_truth = se3.inverse(team.T_truth_body[0, 0])
    figure, panel = plt.subplots(figsize=(8, 8))
    true_m = (T_world_truth @ team.T_truth_body)[..., :3, 3]
    for a, b, i in team.range_at:
        panel.plot(*true_m[[a, b], i, :2].T, color="0.85", lw=0.8, zorder=0)
    colours = plt.get_cmap("tab10").colors  # pyright: ignore[reportAttributeAccessIssue]
    for robot, path_m, colour in zip(team.robots, true_m, colours, strict=False):
        trajectory = found.trajectories[robot.name]
        R, at_m = trajectory.T_world_body[:, :3, :3], trajectory.T_world_body[:, :3, 3]
        panel.plot(*path_m[:, :2].T, color=colour, lw=1, label=robot.name)
        panel.plot(*at_m[:, :2].T, "o", color=colour, ms=4)
        spread = R @ trajectory.covariance[:, 3:, 3:] @ np.swapaxes(R, 1, 2)
        for centre, covariance in zip(at_m[1:, :2], spread[1:, :2, :2], strict=True):
            panel.plot(*_ellipse(centre, covariance).T, color=colour, lw=0.8)
    panel.set(
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
        title=f"true paths (lines), estimates (dots), 95 % ellipses ×{_EXAGGERATION}, measurements (grey)",
    )
    panel.legend(fontsize=8)
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=130, bbox_inches="tight"))
    plt.close(figure)
