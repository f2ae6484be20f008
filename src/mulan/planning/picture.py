"""The plan as one picture: a map of candidates, and what each chosen view would see."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from numpy.typing import NDArray

from mulan.geometry.camera import PinholeCamera
from mulan.mission.run_folder import write_atomically
from mulan.planning.plan import RobotPlan, ViewPlan
from mulan.planning.rays import camera_rays, rows_for
from mulan.radiance.engine import RadianceEngine

_ROBOT_COLOURS = ("#3b82f6", "#ea6a0a", "#0d9f6e", "#a855f7", "#e0457b", "#0891b2")
_VIEW_COLUMNS = 192


def render_view(
    engine: RadianceEngine, camera: PinholeCamera, T_world_camera: NDArray, columns: int
) -> NDArray:
    """What the field shows from a pose: float image h w 3 in [0, 1]."""
    colour = engine.render(*camera_rays(camera, T_world_camera, columns)).colour
    image = colour.cpu().numpy().reshape(rows_for(camera, columns), columns, 3)
    return np.clip(image, 0, 1)


def draw_plan(plan: ViewPlan, engine: RadianceEngine, paths: Mapping[str, NDArray], target: Path) -> None:
    """Write the picture as PNG: top view (metres) on the left, one rendered view a robot on the right."""
    rows = max(1, len(plan.robots))
    figure = Figure(figsize=(11, max(5.5, 2.6 * rows)), dpi=120, layout="constrained", facecolor="white")
    grid = GridSpec(rows, 2, figure=figure, width_ratios=(1.7, 1))
    _draw_map(figure, figure.add_subplot(grid[:, 0]), plan, paths)
    for row, robot_plan in enumerate(plan.robots):
        _draw_view(figure.add_subplot(grid[row, 1]), robot_plan, engine, _colour(row))
    write_atomically(target, lambda temporary: figure.savefig(temporary, format="png"))


def _colour(index: int) -> str:
    return _ROBOT_COLOURS[index % len(_ROBOT_COLOURS)]


def _draw_map(figure: Figure, axes: Axes, plan: ViewPlan, paths: Mapping[str, NDArray]) -> None:
    scores = np.concatenate([p.score for p in plan.robots]) if plan.robots else np.zeros(0)
    scale = Normalize(scores.min(), scores.max()) if len(scores) else Normalize(0, 1)
    dots = None
    for index, p in enumerate(plan.robots):
        name, here = p.robot.robot, p.robot.T_world_camera[:2, 3]
        if name in paths:
            axes.plot(*paths[name].T, color=_colour(index), lw=1.5, alpha=0.7, label=name)
        axes.plot(*here, "s", color=_colour(index), ms=7, mec="white")
        if p.best is None:
            continue
        spots = p.T_world_candidate[:, :2, 3]
        dots = axes.scatter(
            *spots.T, c=p.score, cmap="viridis", norm=scale, s=55, edgecolors="#333", zorder=3
        )
        best = p.T_world_candidate[p.best]
        stand, ahead = best[:2, 3], -best[:2, 2]
        _arrow(axes, here, stand, _colour(index), "->")
        _arrow(axes, stand, stand + 0.7 * float(np.linalg.norm(stand - here)) * ahead, "#111", "-|>")
    axes.plot(*plan.centre_m[:2], "+", color="#111", ms=12, mew=1.5, label="scene centre")
    axes.set(xlabel="x [m]", ylabel="y [m]", title="Where each robot should look next")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.25)
    axes.legend(loc="best", frameon=False, fontsize=9)
    if dots is not None:
        figure.colorbar(dots, ax=axes, shrink=0.75, label=plan.score_meaning)


def _arrow(axes: Axes, start: NDArray, end: NDArray, colour: str, style: str) -> None:
    arrow = {"arrowstyle": style, "color": colour, "lw": 1.8}
    axes.annotate("", tuple(end.tolist()), tuple(start.tolist()), arrowprops=arrow, zorder=4)


def _draw_view(axes: Axes, plan: RobotPlan, engine: RadianceEngine, colour: str) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set(color=colour, linewidth=2)
    if plan.best is None:
        axes.set_title(f"{plan.robot.robot}: no free place, stays", fontsize=10)
        return
    columns = min(_VIEW_COLUMNS, plan.robot.camera.width)
    axes.imshow(render_view(engine, plan.robot.camera, plan.T_world_candidate[plan.best], columns))
    axes.set_title(f"{plan.robot.robot}: what the field expects there", fontsize=10)
