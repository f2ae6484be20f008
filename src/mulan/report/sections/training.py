"""How the field got better while it learned."""

from typing import Any

from mulan.report.charts import chart, colour_of, translucent
from mulan.report.markup import Section, caption, escape, missing
from mulan.report.run_contents import RunContents, setup_title


def section(contents: RunContents) -> Section:
    """PSNR over training time, one colour a setup."""
    runs = {name: run.history for name, run in contents.trained.items() if run.history}
    if not runs:
        return missing("training", "Training", "Nothing has been trained yet.", contents.command("train"))
    traces: list[dict[str, Any]] = []
    for index, (name, history) in enumerate(runs.items()):
        colour, title = colour_of(index), escape(setup_title(name) if name else "held-out views")
        test = [h for h in history if h.get("test_psnr_db") is not None]
        label = f"{title}, training rays" if name else "training rays"
        light = {"color": translucent(colour, 0.65), "width": 1.5, "dash": "dot"}
        traces.append(_curve(history, "train_psnr_db", label, light) | {"showlegend": not test or not name})
        if test:
            curve = _curve(test, "test_psnr_db", title, {"color": colour, "width": 2.6})
            traces.append(curve | {"mode": "lines+markers", "marker": {"size": 5, "color": colour}})
    layout = {
        "xaxis": {"title": {"text": "training time [s]"}, "rangemode": "tozero"},
        "yaxis": {"title": {"text": "PSNR [dB]"}},
        "hovermode": "x unified",
    }
    note = "Solid: held-out views. Dotted: the rays being learned from."
    return Section(
        "training", "Training", chart("PSNR over training time", traces, layout, 380) + caption(note)
    )


def _curve(history: list[dict[str, Any]], key: str, name: str, line: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "x": [h["seconds"] for h in history],
        "y": [h.get(key) for h in history],
        "name": name,
        "line": line,
        "hovertemplate": "%{y:.2f} dB",
    }
