"""The commands worth typing next."""

from mulan.report.markup import Section, escape
from mulan.report.run_contents import RunContents


def section(contents: RunContents) -> Section:
    """First what the run still lacks, then what can be done with what it has."""
    lines = []
    trained = any(run.history for run in contents.trained.values())
    if contents.localization is None and not trained:
        lines.append(("localize", "place the robots in one frame"))
    if not trained:
        lines.append(("train", "learn the radiance field"))
    if trained:
        again = " again, after new photographs" if contents.plan is not None else ""
        lines.append(("plan", f"propose the next views{again}"))
        lines.append(("render", "make pictures from new viewpoints"))
    lines.append(("report", "write this page again"))
    rows = "".join(
        f"<li><code>{escape(contents.command(name))}</code><span>{escape(purpose)}</span></li>"
        for name, purpose in lines
    )
    return Section("next", "Next", f'<ul class="commands">{rows}</ul>')
