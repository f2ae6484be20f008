"""Views the field never saw: the photograph, what the field shows, and the difference."""

import re
from pathlib import Path

from mulan.report.markup import Section, escape, missing
from mulan.report.pictures import (
    absolute_error,
    colour_error,
    data_uri,
    error_gradient_css,
    error_scale,
    load_rgb,
    psnr_db,
)
from mulan.report.run_contents import RunContents, setup_title

_MOST_PICTURES = 24
_MOST_VIEWS = 4
_LONGEST_SIDE = 300


def section(contents: RunContents) -> Section | None:
    """A row a view: photograph, rendering, error (one column a setup); None before training."""
    views = _common_views(contents)
    if not views and not any(run.history for run in contents.trained.values()):
        return None
    if not views:
        return missing("views", "Held-out views", "No held-out view was rendered.", contents.command("train"))
    most = max(1, min(_MOST_VIEWS, _MOST_PICTURES // (1 + 2 * len(contents.trained))))
    chosen = views if len(views) <= most else [views[i * len(views) // most] for i in range(most)]
    truths = {v: load_rgb(_picture(next(iter(contents.trained.values())), v, "true")) for v in chosen}
    renders = {
        (v, name): load_rgb(_picture(run, v, "rendered"))
        for v in chosen
        for name, run in contents.trained.items()
    }
    errors = {
        (v, name): absolute_error(truths[v], image)
        for (v, name), image in renders.items()
        if image.shape == truths[v].shape
    }
    scale = error_scale(list(errors.values()))
    blocks = []
    for v in chosen:
        cells = [_figure(data_uri(truths[v], _LONGEST_SIDE), "Photograph", f"view {v}", "true")]
        for name in contents.trained:
            render = renders[v, name]
            title = setup_title(name) if name else "Rendered"
            if (v, name) not in errors:
                cells.append(_figure(data_uri(render, _LONGEST_SIDE), title, "another size", "rendered"))
                continue
            quality = f"{psnr_db(truths[v], render):.1f} dB"
            wrong = data_uri(colour_error(errors[v, name], scale), _LONGEST_SIDE)
            cells.append(
                '<div class="pair">'
                + _figure(data_uri(render, _LONGEST_SIDE), title, quality, "rendered")
                + _figure(wrong, "Error", "", "error")
                + "</div>"
            )
        blocks.append(f'<div class="view" style="--setups:{len(contents.trained)}">{"".join(cells)}</div>')
    bar = (
        f'<div class="scale"><span>no error</span>'
        f'<span class="bar" style="background:{error_gradient_css()}"></span>'
        f"<span>{scale:g} or more</span></div>"
        '<p class="caption">Error is the mean absolute difference over the colour channels, which lie in '
        "0 … 1; one scale for all pictures.</p>"
    )
    return Section("views", "Held-out views", "".join(blocks) + bar)


def _common_views(contents: RunContents) -> list[str]:
    """Numbers of the views every trained run has both pictures of."""
    found: list[set[str]] = []
    for run in contents.trained.values():
        names = {path.name for path in run.run.renders.glob("*.png")} if run.run.renders.is_dir() else set()
        numbers = {m[1] for name in names if (m := re.fullmatch(r"(\d+)_true\.png", name))}
        found.append({n for n in numbers if f"{n}_rendered.png" in names})
    return sorted(set.intersection(*found)) if found else []


def _picture(run: RunContents, view: str, kind: str) -> Path:
    return run.run.renders / f"{view}_{kind}.png"


def _figure(source: str, title: str, note: str, kind: str) -> str:
    text = f"<strong>{escape(title)}</strong> {escape(note)}"
    return (
        f'<figure class="{kind}"><img src="{source}" alt="{escape(title)} {escape(note)}" loading="lazy">'
        f"<figcaption>{text}</figcaption></figure>"
    )
