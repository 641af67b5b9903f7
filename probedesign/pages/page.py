"""A page: headings, tables and figures in one HTML file that asks nothing of a network."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

STYLE = """
@page { size: A4; margin: 14mm }
body { font: 10.5pt/1.4 Helvetica, Arial, "Liberation Sans", "DejaVu Sans", sans-serif; color: #111;
  max-width: 260mm; margin: 8mm auto; padding: 0 4mm }
h1 { font-size: 18pt; margin: 0 } h2 { font-size: 12.5pt; margin: 0 0 1mm }
.about { color: #444; margin: 1mm 0 4mm }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(88mm, 1fr)); gap: 5mm }
section { break-inside: avoid; margin: 0 0 4mm } section svg { width: 100%; height: auto; display: block }
section p { color: #333; margin: 1mm 0; font-size: 9.5pt }
table { border-collapse: collapse; font-size: 9.5pt; break-inside: avoid }
th, td { text-align: right; padding: 0.8mm 3mm; border-bottom: 0.4pt solid #bbb; white-space: nowrap }
th:first-child, td:first-child, .last td:last-child { text-align: left } .last td:last-child { white-space: normal }
.last table { break-inside: auto; font-size: 9pt } tr { break-inside: avoid }
thead th { border-bottom: 1pt solid #111 }
@media print { body { margin: 0; padding: 0; max-width: none } section p { font-size: 8.5pt }
  .figures { grid-template-columns: 1fr 1fr } }
"""


@dataclass(frozen=True)
class Section:
    """One thing to look at.

    Attributes:
        heading: what it answers.
        caption: how to read it, and what it counts.
        svg: the figure.
    """

    heading: str
    caption: str
    svg: bytes


@dataclass(frozen=True)
class TextTable:
    """Rows of text under a head; the first column names them; a note below, if any."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    def html(self) -> str:
        """The element."""
        head = "".join(f"<th>{escape(cell)}</th>" for cell in self.head)
        rows = "".join(f"<tr>{''.join(f'<td>{escape(c)}</td>' for c in row)}</tr>" for row in self.rows)
        note = f"<p>{escape(self.note)}</p>" if self.note else ""
        return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{note}"


def page_of(
    title: str,
    about: Sequence[str],
    table: TextTable,
    sections: Sequence[Section],
    after: Sequence[tuple[str, TextTable]] = (),
) -> bytes:
    """The page.

    Args:
        title: of it.
        about: lines under the title: what the numbers rest on.
        table: of the figures that matter most.
        sections: in order.
        after: headings and tables at the end.
    """
    lines = "<br>".join(map(escape, about))
    figures = "".join(
        f"<section><h2>{escape(s.heading)}</h2>{_named(s).decode()}<p>{escape(s.caption)}</p></section>\n"
        for s in sections
    )
    last = "".join(
        f"<section class=last><h2>{escape(name)}</h2>{rows.html()}</section>\n" for name, rows in after
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n'
        f'<body><h1>{escape(title)}</h1>\n<p class="about">{lines}</p>\n<section>{table.html()}</section>\n'
        f'<div class="figures">\n{figures}</div>\n{last}</body></html>\n'
    ).encode()


def _named(section: Section) -> bytes:
    """The figure with its heading for those who cannot see it."""
    return section.svg.replace(
        b"<svg ", f'<svg role="img" aria-label="{escape(section.heading)}" '.encode(), 1
    )
