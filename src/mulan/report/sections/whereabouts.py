"""Where the robots were: from above and in space."""

from mulan.report.charts import chart
from mulan.report.map_traces import (
    bearing_traces,
    common_exaggeration,
    ellipse_traces,
    path_traces,
    robots_on_map,
)
from mulan.report.markup import Section, caption, missing
from mulan.report.run_contents import RunContents


def section(contents: RunContents) -> Section:
    """Top view and 3-D view with paths, photographs, 95 % regions and bearings."""
    if contents.localization is None:
        return missing(
            "map",
            "Robot paths",
            "No robot has been localized yet, so there are no paths, errors or bearings to show.",
            contents.command("localize"),
        )
    robots = robots_on_map(contents.localization)
    factor = common_exaggeration(robots)
    views = {
        in_space: [
            *bearing_traces(contents.localization, robots, in_space),
            *ellipse_traces(robots, in_space, factor),
            *path_traces(robots, in_space),
        ]
        for in_space in (False, True)
    }
    top = {
        "xaxis": {"title": {"text": "x [m]"}},
        "yaxis": {"title": {"text": "y [m]"}, "scaleanchor": "x", "scaleratio": 1},
        "hovermode": "closest",
    }
    space = {
        "scene": {
            **{f"{a}axis": {"title": {"text": f"{a} [m]"}} for a in "xyz"},
            "aspectmode": "data",
            "camera": {"eye": {"x": 1.15, "y": -2.0, "z": 1.25}, "center": {"x": 0, "y": 0, "z": -0.12}},
        },
        "showlegend": False,
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }
    body = (
        '<div class="columns"><figure><figcaption>From above</figcaption>'
        + chart("Map of the robots from above", views[False], top, 480)
        + "</figure><figure><figcaption>In space, drag to turn</figcaption>"
        + chart("Map of the robots in space", views[True], space, 480)
        + "</figure></div>"
    )
    anchor = contents.localization["anchor"]
    size = "at true size" if factor == 1 else f"drawn {factor} times larger than they are"
    text = (
        f"The world is the start frame of {anchor}. Outlines hold 95 % of the position probability, {size}."
    )
    return Section("map", "Robot paths", body + caption(text))
