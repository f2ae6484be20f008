"""One run, one page: everything inlined, nothing fetched."""

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import TypeVar

from mulan.errors import InputError
from mulan.mission.run_folder import RunFolder, write_atomically
from mulan.report.markup import Section, escape
from mulan.report.run_contents import RunContents, read_run
from mulan.report.sections import (
    accuracy,
    aoa,
    bearing_errors,
    configuration,
    held_out,
    next_commands,
    proposed_views,
    setups,
    summary,
    training,
    trust,
    whereabouts,
)

_Part = TypeVar("_Part")

# the browser itself refuses anything that is not in the page
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"

# each section with the file a damaged entry would be in
_SECTIONS: tuple[tuple[Callable[[RunContents], Section | None], str], ...] = (
    (setups.section, "metrics.json"),
    (held_out.section, "renders"),
    (training.section, "history.json"),
    (whereabouts.section, "localization.json"),
    (accuracy.section, "localization.json"),
    (trust.section, "localization.json"),
    (aoa.section, "localization.json"),
    (bearing_errors.section, "localization.json"),
    (proposed_views.section, "plan.json"),
    (configuration.section, "config.json"),
    (next_commands.section, "config.json"),
)


def write_report(run: RunFolder) -> Path:
    """Write ``report.html``: whatever the run holds, and which command makes what it does not.

    Returns:
        The page, self-contained: it opens from disk with no network.

    Raises:
        InputError: The folder does not exist, or one of its files is damaged.
    """
    contents = read_run(run)
    known = (run.config, run.localization, run.transforms, run.history, run.metrics)
    if not any(path.exists() for path in known):
        raise InputError(run.root, "run folder", "holds no run", "give the folder a mulan command wrote")
    text = page_html(contents)
    write_atomically(run.report, lambda temporary: temporary.write_text(text, encoding="utf-8") and None)
    return run.report


def page_html(contents: RunContents) -> str:
    """The whole page.

    Raises:
        InputError: A file of the run lacks an entry or holds one of the wrong kind.
    """
    head = _checked(contents, "metrics.json or localization.json", summary.header)
    sections = [s for build, file in _SECTIONS if (s := _checked(contents, file, build)) is not None]
    links = "".join(f'<a href="#{s.anchor}">{escape(s.title)}</a>' for s in sections if not s.is_missing)
    title = escape(contents.run.root.resolve().name)
    has_charts = any('class="chart"' in s.body for s in sections)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{title} · MULAN report</title>
<link rel="icon" href="data:,">
<style>{_own("sections.css")}{_own("style.css")}</style>
</head>
<body>
<main>
{head}
<nav aria-label="Sections">{links}</nav>
{"".join(s.html() for s in sections)}
</main>
{f"<script>{_plotly()}</script><script>{_own('charts.js')}</script>" if has_charts else ""}
</body>
</html>
"""


def _checked(contents: RunContents, file: str, build: Callable[[RunContents], _Part]) -> _Part:
    """Build a part; a damaged file becomes one sentence."""
    try:
        return build(contents)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        source = contents.run.root / file
        what = f"entry {error} is missing" if isinstance(error, KeyError) else str(error)
        raise InputError(source, "content", what, "delete the file and make it again") from error


def _own(name: str) -> str:
    return resources.files("mulan.report").joinpath(name).read_text(encoding="utf-8")


def _plotly() -> str:
    # read as a file: importing plotly itself costs a second and is not needed
    source = resources.files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
    return source.replace("</script", "<\\/script")
