"""Do the radio's stated sigmas match its errors?"""

import numpy as np

from mulan.report.charts import chart, colour_of
from mulan.report.markup import Section, caption, escape
from mulan.report.run_contents import RunContents

_SMALLEST_DEG = 0.01  # keeps a perfect bearing on the logarithmic axis
_TICKS_DEG = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 180]


def section(contents: RunContents) -> Section | None:
    """Scatter of error against stated sigma; None where no truth is known."""
    bearings = [
        b
        for b in (contents.localization or {}).get("bearings", [])
        if b.get("error_rad") is not None and b.get("sigma_rad") is not None
    ]
    if not bearings:
        return None
    sigma = np.degrees([float(b["sigma_rad"]) for b in bearings])
    error = np.maximum(np.degrees([abs(float(b["error_rad"])) for b in bearings]), _SMALLEST_DEG)
    low, high = float(min(sigma.min(), error.min())), float(max(sigma.max(), error.max()))
    line = [float(sigma.min()) * 0.7, float(sigma.max()) * 1.4]
    traces = [
        _guide("error = sigma", line, line, "solid"),
        _guide("error = 2 sigma", line, [2 * v for v in line], "dot"),
    ]
    for index, robot in enumerate(contents.robots):
        mine = [i for i, b in enumerate(bearings) if b["observer"] == robot]
        if mine:
            traces.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "x": sigma[mine].tolist(),
                    "y": error[mine].tolist(),
                    "name": f"heard by {escape(robot)}",
                    "marker": {
                        "color": colour_of(index),
                        "size": 9,
                        "opacity": 0.85,
                        "symbol": ["circle" if bearings[i]["inlier"] >= 0.5 else "x" for i in mine],
                    },
                    "customdata": [escape(str(bearings[i]["peer"])) for i in mine],
                    "hovertemplate": "from %{customdata}: sigma %{x:.2f}°, error %{y:.2f}°<extra></extra>",
                }
            )
    layout = {
        "xaxis": {"title": {"text": "stated sigma [°]"}, "type": "log", "tickvals": _TICKS_DEG},
        "yaxis": {
            "title": {"text": "error [°]"},
            "type": "log",
            "tickvals": _TICKS_DEG,
            "range": [float(np.log10(low * 0.7)), float(np.log10(high * 1.4))],
        },
    }
    trusted = np.array([b["inlier"] >= 0.5 for b in bearings])
    within = f"{np.mean(error[trusted] <= 2 * sigma[trusted]):.0%}" if trusted.any() else "none"
    kept, dropped = int(trusted.sum()), int((~trusted).sum())
    text = (
        f"{len(bearings)} bearings; median error {np.median(error):.1f}°. Of the {kept} that the pose graph "
        f"trusted, {within} lie within two stated sigmas; it set {dropped} aside (crosses)."
    )
    body = chart("Bearing error against stated sigma", traces, layout, 400) + caption(text)
    return Section("bearings", "Bearing errors", body)


def _guide(name: str, x: list[float], y: list[float], dash: str) -> dict:
    line = {"color": "$muted", "width": 1.2, "dash": dash}
    return {
        "type": "scatter",
        "mode": "lines",
        "x": x,
        "y": y,
        "name": name,
        "line": line,
        "hoverinfo": "skip",
    }
