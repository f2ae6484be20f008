"""The localization as one picture: paths, 95 % ellipses, bearings and who measured whom, from above."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from mulan.mission.run_folder import write_atomically

_ROBOT_COLOURS = ("#3b82f6", "#ea6a0a", "#0d9f6e", "#a855f7", "#e0457b", "#0891b2")
_CHI2_95 = 5.991  # two freedoms
_MOST_ELLIPSES = 12
_MOST_BEARINGS = 200
_VISIBLE_PART = 0.02  # of the picture, that the largest ellipse should have
_FACTORS = (1, 2, 5, 10, 20, 50, 100)


def draw_localization(record: dict[str, Any], target: Path) -> None:
    """Write the picture as PNG.

    Args:
        record: Content of ``localization.json``.
        target: File.

    Raises:
        InputError: The disk is full or the folder cannot be written.
    """
    figure = Figure(figsize=(12, 6), dpi=120, layout="constrained", facecolor="white")
    where, who = figure.subplots(1, 2, width_ratios=(1.6, 1))
    _draw_map(where, record)
    _draw_graph(who, record)
    write_atomically(target, lambda temporary: figure.savefig(temporary, format="png"))


def _colours(record: dict[str, Any]) -> dict[str, str]:
    names = [*record["robots"], *(u["robot"] for u in record.get("undetermined", []))]
    return {name: _ROBOT_COLOURS[i % len(_ROBOT_COLOURS)] for i, name in enumerate(names)}


def _horizontal(entry: dict[str, Any]) -> tuple[Float[NDArray, "n 2"], Float[NDArray, "n 2 2"]]:
    """Positions at the photographs and their covariances in the world's plane."""
    T = np.array(entry["T_world_body"], dtype=float).reshape(-1, 4, 4)
    body = np.array(entry["covariance"], dtype=float).reshape(-1, 6, 6)[:, 3:, 3:]
    R = T[:, :3, :3]
    return T[:, :2, 3], (R @ body @ np.swapaxes(R, 1, 2))[:, :2, :2]


def _exaggeration(record: dict[str, Any]) -> int:
    """One factor for all ellipses that makes the largest visible."""
    places = [_horizontal(entry) for entry in record["robots"].values()]
    points = np.concatenate(
        [p for p, _ in places] + [np.array(e["path"])[:, :2] for e in record["robots"].values()]
    )
    largest = max((float(np.sqrt(c.trace(axis1=1, axis2=2).max())) for _, c in places if len(c)), default=0.0)
    wanted = _VISIBLE_PART * float(np.ptp(points, axis=0).max())
    return next((f for f in _FACTORS if f * largest >= wanted), _FACTORS[-1]) if largest > 0 else 1


def _draw_map(axes: Axes, record: dict[str, Any]) -> None:
    colours, factor = _colours(record), _exaggeration(record)
    bearings = record["bearings"]
    for bearing in bearings[:: max(1, len(bearings) // _MOST_BEARINGS)]:
        start, u = np.array(bearing["origin_world"])[:2], np.array(bearing["direction_world"])[:2]
        trusted = bearing["inlier"] >= 0.5
        axes.plot(
            *np.stack([start, start + u]).T,
            color=colours[bearing["observer"]] if trusted else "#dc2626",
            lw=0.8,
            ls="-" if trusted else ":",
            alpha=0.5,
        )
    for name, entry in record["robots"].items():
        if entry["truth_path"]:
            axes.plot(*np.array(entry["truth_path"])[:, :2].T, color="#888", lw=1, ls="--")
        axes.plot(*np.array(entry["path"])[:, :2].T, color=colours[name], lw=1.5, label=name)
        points, covariance = _horizontal(entry)
        for i in range(0, len(points), max(1, len(points) // _MOST_ELLIPSES)):
            value, vector = np.linalg.eigh(covariance[i])
            width, height = 2 * factor * np.sqrt(_CHI2_95 * np.maximum(value[::-1], 0))
            angle = np.degrees(np.arctan2(vector[1, 1], vector[0, 1]))
            shape = Ellipse(
                tuple(points[i]), width, height, angle=angle, fc=colours[name], ec=colours[name], alpha=0.25
            )
            axes.add_patch(shape)
    size = "true size" if factor == 1 else f"drawn {factor}×"
    axes.set(
        xlabel="x [m]", ylabel="y [m]", title=f"Paths, 95 % ellipses ({size}), bearings (red: not believed)"
    )
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.25)
    axes.legend(loc="best", frameon=False, fontsize=8)


def _draw_graph(axes: Axes, record: dict[str, Any]) -> None:
    """Robots on a circle; an arrow from observer to peer is as wide as its bearings are many."""
    colours = _colours(record)
    angle = np.linspace(0.5 * np.pi, 2.5 * np.pi, len(colours), endpoint=False)
    place = {name: np.array([np.cos(a), np.sin(a)]) for name, a in zip(colours, angle, strict=True)}
    trusted: dict[tuple[str, str], list[float]] = {}
    for bearing in record["bearings"]:
        trusted.setdefault((bearing["observer"], bearing["peer"]), []).append(float(bearing["inlier"]))
    for (observer, peer), inlier in trusted.items():
        good = float(np.mean(inlier))
        style = {
            "arrowstyle": "-|>",
            "color": colours[observer] if good >= 0.5 else "#dc2626",
            "lw": 0.6 + 0.5 * np.log1p(len(inlier)),
            "ls": "-" if good >= 0.5 else ":",
            "connectionstyle": "arc3,rad=0.12",
            "shrinkA": 14,
            "shrinkB": 14,
        }
        axes.annotate("", tuple(place[peer]), tuple(place[observer]), arrowprops=style)
    suspects = {s["robot"] for s in record.get("suspects", [])}
    open_ones = {u["robot"] for u in record.get("undetermined", [])}
    for name, at in place.items():
        mark = "not placed" if name in open_ones else "not believed" if name in suspects else ""
        face = "white" if name in open_ones else colours[name]
        axes.plot(*at, "o", ms=18, mfc=face, mec="#dc2626" if mark else "white", mew=2)
        axes.annotate(f"{name}\n{mark}".strip(), tuple(1.22 * at), ha="center", va="center", fontsize=9)
    axes.set(xlim=(-1.6, 1.6), ylim=(-1.5, 1.5), title="Who measured whom (bearings)")
    axes.set_aspect("equal")
    axes.axis("off")
