"""The few pieces of HTML every section is made of; all text is escaped here, once."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

__all__ = ["Section", "caption", "escape", "missing", "table"]


@dataclass(frozen=True)
class Section:
    """One block of the page.

    Attributes:
        anchor: Fragment identifier.
        title: Heading, plain text.
        body: Trusted HTML.
        is_missing: Whether the run lacks this part and the body only says how to make it.
    """

    anchor: str
    title: str
    body: str
    is_missing: bool = False

    def html(self) -> str:
        """The block."""
        kind = "section missing" if self.is_missing else "section"
        heading = f"<h2>{escape(self.title)}</h2>"
        return f'<section class="{kind}" id="{self.anchor}">{heading}\n{self.body}\n</section>'


def missing(anchor: str, title: str, what: str, command: str) -> Section:
    """A section the run cannot fill yet, with the command that makes it."""
    body = f"<p>{escape(what)} Make it with <code>{escape(command)}</code></p>"
    return Section(anchor, title, body, is_missing=True)


def caption(text: str) -> str:
    """A line of explanation in plain text."""
    return f'<p class="caption">{escape(text)}</p>'


def table(header: Sequence[str], rows: Iterable[Sequence[str]], best: Iterable[tuple[int, int]] = ()) -> str:
    """A table of plain text: first column names, the others numbers; ``best`` (row, column) stand out."""
    marked = set(best)
    head = "".join(f'<th scope="col">{escape(h)}</th>' for h in header)
    lines = []
    for i, row in enumerate(rows):
        cells = [f'<th scope="row">{escape(row[0])}</th>']
        for j, cell in enumerate(row[1:], start=1):
            cells.append(
                f'<td class="best">{escape(cell)}</td>' if (i, j) in marked else f"<td>{escape(cell)}</td>"
            )
        lines.append(f"<tr>{''.join(cells)}</tr>")
    parts = f"<thead><tr>{head}</tr></thead><tbody>{''.join(lines)}</tbody>"
    return f'<div class="scroll"><table>{parts}</table></div>'
