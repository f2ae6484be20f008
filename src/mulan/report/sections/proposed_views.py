"""Where each robot should take its next photograph."""

from collections.abc import Iterator
from pathlib import Path

from mulan.report.markup import Section, caption, missing, table
from mulan.report.pictures import data_uri, load_rgb
from mulan.report.run_contents import RunContents

_LONGEST_SIDE = 1320


def section(contents: RunContents) -> Section:
    """The plan's picture and a row a robot."""
    if contents.plan is None:
        return missing("plan", "Next views", "No view has been proposed yet.", contents.command("plan"))
    rows = []
    for name, robot in contents.plan["robots"].items():
        candidates = robot["candidates"]
        if robot["best"] is None:
            rows.append(
                [
                    name,
                    "stays: no view is worth the way" if candidates else "stays: no free place",
                    "–",
                    "–",
                    "–",
                    str(len(candidates)),
                ]
            )
            continue
        best = candidates[robot["best"]]
        x, y, z = (row[3] for row in best["T_world_camera"][:3])
        mean = sum(c["score"] for c in candidates) / len(candidates)
        rows.append(
            [
                name,
                f"({x:.2f}, {y:.2f}, {z:.2f})",
                f"{best['score']:.4g}",
                f"{best['score'] / mean - 1:+.0%}" if mean > 0 else "–",
                f"{best['position_sigma_m'] * 100:.1f}",
                str(len(candidates)),
            ]
        )
    header = ["Robot", "Go to [m]", "Gain", "Against the mean", "Sigma there [cm]", "Free candidates"]
    body = table(header, rows)
    picture = next((p for p in _picture_places(contents) if p.exists()), None)
    if picture is not None:
        image = data_uri(load_rgb(picture), _LONGEST_SIDE)
        alt = "Map of candidate views coloured by gain, with the chosen views rendered beside it"
        body = f'<img class="wide" src="{image}" alt="{alt}">' + body
    meaning = contents.plan.get("score_meaning", "expected variance reduction per ray")
    note = f"Gain: {meaning}, at the pose uncertainty the robot would have there."
    return Section("plan", "Next views", body + caption(note))


def _picture_places(contents: RunContents) -> Iterator[Path]:
    for run in (contents, *contents.setups.values()):
        yield run.run.plan.with_suffix(".png")
