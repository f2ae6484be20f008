"""The pieces of the map: paths, photographs, ellipses and bearings as traces, in the plane or in space."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import NDArray

from mulan.report.charts import colour_of, translucent
from mulan.report.covariance_shapes import (
    ellipse_95,
    ellipsoid_95,
    exaggeration_for,
    position_covariance_world,
)
from mulan.report.markup import escape

_MOST_ELLIPSES_A_ROBOT = 10
_MOST_BEARINGS = 60
_GAP = np.full((1, 3), np.nan)

Trace = dict[str, Any]


@dataclass(frozen=True)
class RobotOnMap:
    """One robot's geometry in the world frame, metres.

    Attributes:
        name: As recorded.
        colour: Of all its traces.
        path, truth: Estimated and true path; truth None where unknown.
        photos: Body positions at its photographs.
        time_s: Exposure times.
        covariance: Position covariance at each photograph, world axes.
    """

    name: str
    colour: str
    path: Float[NDArray, "p 3"]
    truth: Float[NDArray, "q 3"] | None
    photos: Float[NDArray, "n 3"]
    time_s: Float[NDArray, "n"]
    covariance: Float[NDArray, "n 3 3"]


def robots_on_map(localization: dict[str, Any]) -> list[RobotOnMap]:
    """All robots of localization.json."""
    robots = []
    for index, (name, record) in enumerate(localization["robots"].items()):
        T = np.array(record["T_world_body"], dtype=float).reshape(-1, 4, 4)
        covariance = np.array(record["covariance"], dtype=float).reshape(-1, 6, 6)
        truth = record.get("truth_path")
        robots.append(
            RobotOnMap(
                name=name,
                colour=colour_of(index),
                path=np.array(record["path"], dtype=float).reshape(-1, 3),
                truth=np.array(truth, dtype=float).reshape(-1, 3) if truth else None,
                photos=T[:, :3, 3],
                time_s=np.array(record["time_s"], dtype=float),
                covariance=position_covariance_world(T, covariance),
            )
        )
    return robots


def extent_m(robots: list[RobotOnMap]) -> float:
    """Longest side of the box about all paths."""
    points = np.concatenate([np.concatenate([r.path, r.photos]) for r in robots])
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


def common_exaggeration(robots: list[RobotOnMap]) -> int:
    """One factor for all ellipses of the map; one where they can be seen as they are."""
    return exaggeration_for(np.concatenate([r.covariance for r in robots]), extent_m(robots))


def path_traces(robots: list[RobotOnMap], in_space: bool) -> list[Trace]:
    """True paths dashed beneath estimated paths, and photographs as dots."""
    traces = []
    for i, robot in enumerate(r for r in robots if r.truth is not None):
        assert robot.truth is not None
        traces.append(
            _line(robot.truth, in_space, color="$muted", width=3 if in_space else 1.8, dash="dash")
            | {"name": "true path", "legendgroup": "truth", "showlegend": i == 0, "hoverinfo": "skip"}
        )
    for robot in robots:
        name = escape(robot.name)
        traces.append(
            _line(robot.path, in_space, color=robot.colour, width=5 if in_space else 2.2)
            | {"name": name, "legendgroup": name, "hoverinfo": "skip"}
        )
        traces.append(
            _points(robot.photos, in_space)
            | {
                "mode": "markers",
                "marker": {"size": 3.5 if in_space else 6, "color": robot.colour, "line": {"width": 0}},
                "name": f"{name} photographs",
                "legendgroup": name,
                "showlegend": False,
                "customdata": robot.time_s.tolist(),
                "hovertemplate": f"{name}, photograph at %{{customdata:.1f}} s<extra></extra>",
            }
        )
    return traces


def ellipse_traces(robots: list[RobotOnMap], in_space: bool, exaggeration: int) -> list[Trace]:
    """95 % regions of some photographs of each robot, one trace a robot."""
    traces = []
    for robot in robots:
        chosen = _spread(len(robot.photos), _MOST_ELLIPSES_A_ROBOT)
        outlines: list[NDArray] = []
        for i in chosen:
            if in_space:
                rings = ellipsoid_95(robot.photos[i], robot.covariance[i], exaggeration)
            else:
                flat = ellipse_95(robot.photos[i, :2], robot.covariance[i, :2, :2], exaggeration)
                rings = [np.column_stack([flat, np.zeros(len(flat))])]
            outlines += [part for ring in rings for part in (ring, _GAP)]
        if outlines:
            name = escape(robot.name)
            line = _line(np.concatenate(outlines), in_space, color=translucent(robot.colour, 0.75), width=1.2)
            fill = {} if in_space else {"fill": "toself", "fillcolor": translucent(robot.colour, 0.14)}
            hidden = {"name": f"{name} 95 %", "legendgroup": name, "showlegend": False, "hoverinfo": "skip"}
            traces.append(line | fill | hidden)
    return traces


def bearing_traces(localization: dict[str, Any], robots: list[RobotOnMap], in_space: bool) -> list[Trace]:
    """Radio bearings as rays that end beside the peer; those judged outliers dotted."""
    segments, inliers = bearing_segments(localization, robots)
    traces = []
    for inlier, name, dash, colour in (
        (True, "bearing", "solid", translucent("#7b8794", 0.45)),
        (False, "outlier bearing", "dot", "#d64545"),
    ):
        rays = segments[inliers == inlier]
        if len(rays):
            with_gaps = np.concatenate([rays, np.broadcast_to(_GAP, (len(rays), 1, 3))], 1).reshape(-1, 3)
            line = _line(with_gaps, in_space, color=colour, width=1, dash=dash)
            traces.append(line | {"name": name, "hoverinfo": "skip"})
    return traces


def bearing_segments(
    localization: dict[str, Any], robots: list[RobotOnMap], until_s: float = np.inf
) -> tuple[Float[NDArray, "n 2 3"], Bool[NDArray, "n"]]:
    """Some of the bearings as segments that end beside the peer, and whether each was judged an inlier."""
    by_name = {robot.name: robot for robot in robots}
    bearings = [b for b in localization["bearings"] if b["time_s"] <= until_s]
    kept = [bearings[i] for i in _spread(len(bearings), _MOST_BEARINGS)]
    segments = np.array([_segment(b, by_name) for b in kept], dtype=float).reshape(-1, 2, 3)
    return segments, np.array([b["inlier"] >= 0.5 for b in kept], dtype=bool)


def _segment(bearing: dict[str, Any], robots: dict[str, RobotOnMap]) -> Float[NDArray, "2 3"]:
    origin, direction = (np.array(bearing[k], dtype=float) for k in ("origin_world", "direction_world"))
    peer = robots.get(bearing["peer"])
    reach = 1.0
    if peer is not None and len(peer.photos):
        nearest = peer.photos[np.abs(peer.time_s - bearing["time_s"]).argmin()]
        reach = float(np.linalg.norm(nearest - origin))
    return np.stack([origin, origin + reach * direction])


def _points(points: NDArray, in_space: bool) -> Trace:
    trace: Trace = {"type": "scatter3d" if in_space else "scatter", "x": points[:, 0].tolist()}
    trace["y"] = points[:, 1].tolist()
    if in_space:
        trace["z"] = points[:, 2].tolist()
    return trace


def _line(points: NDArray, in_space: bool, **style: Any) -> Trace:
    return _points(points, in_space) | {"mode": "lines", "line": style, "connectgaps": False}


def _spread(count: int, most: int) -> list[int]:
    """At most ``most`` indices spread evenly over ``count``."""
    return sorted({int(i) for i in np.linspace(0, count - 1, min(count, most))}) if count else []
