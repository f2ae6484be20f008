"""The options that made the run."""

from typing import Any

from mulan.report.markup import Section, escape, missing, table
from mulan.report.run_contents import RunContents


def section(contents: RunContents) -> Section:
    """One folded table a command."""
    if not contents.config:
        what = "No command has recorded its options here."
        return missing("configuration", "Configuration", what, contents.command("run"))
    blocks = []
    for command, options in contents.config.items():
        rows = [[key, value] for key, value in _flat(options, "")]
        content = table(["Option", "Value"], rows) if rows else '<p class="plain">No options.</p>'
        blocks.append(
            f"<details><summary><code>mulan {escape(str(command))}</code>"
            f'<span class="count">{len(rows)} options</span></summary>{content}</details>'
        )
    return Section("configuration", "Configuration", f'<div class="options">{"".join(blocks)}</div>')


def _flat(value: Any, prefix: str) -> list[tuple[str, str]]:
    """Nested options as dotted names."""
    if isinstance(value, dict):
        return [
            pair for key, v in value.items() for pair in _flat(v, f"{prefix}.{key}" if prefix else str(key))
        ]
    return [(prefix, "–" if value is None else str(value))]
