"""HTML pages in one file that needs no network and prints on A4: shell, style sheet, tables and figures.

`html_document` is the shell of every page; `report_page` is the layout of a report.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from probedesign.core.errors import InputError

DOCTYPE = "<!DOCTYPE html>"
#: Links to the other pages of a design at the head of a page, which `web.home` writes.
NAVIGATION = re.compile(rb"<nav>.*?</nav>", re.DOTALL)
#: Common to all pages; dark where the reader's system is, and always light in print.
STYLE = """
@page { size: A4; margin: 14mm }
:root { color-scheme: light dark; --ink: #111; --soft: #444; --rule: #bbb; --paper: #fff; --link: #1a5fa8;
  --alarm: #b00020 }
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e8e8e8; --soft: #b8b8b8; --rule: #555; --paper: #16181c; --link: #7db9f2; --alarm: #ff8a94 }
  canvas, .legend svg { filter: invert(1) hue-rotate(180deg) }
}
@media print { :root { color-scheme: light } }
body { font: 16px/1.5 system-ui, -apple-system, "Segoe UI", "Liberation Sans", "DejaVu Sans", sans-serif;
  font-variant-numeric: tabular-nums; color: var(--ink); background: var(--paper); max-width: 260mm; margin: 24px auto;
  padding: 0 16px; overflow-wrap: break-word }
a { color: var(--link) }
nav { display: flex; flex-wrap: wrap; gap: 4px 16px; font-size: 14px; padding: 0 0 8px; margin: 0 0 16px;
  border-bottom: 1px solid var(--rule); color: var(--soft) } nav:empty { display: none }
h1 { font-size: 28px; line-height: 1.2; margin: 0 } .about { color: var(--soft); margin: 4px 0 16px; font-size: 14px }
.verdict { font-size: 20px; line-height: 1.4; margin: 8px 0 }
.wide { overflow-x: auto }
table { border-collapse: collapse; font-size: 9.5pt; break-inside: avoid }
th, td { text-align: right; padding: 0.8mm 3mm; border-bottom: 0.4pt solid var(--rule); white-space: nowrap }
thead th, thead td { border-bottom: 1pt solid var(--ink) }
@media print { body { font: 10.5pt/1.4 Helvetica, Arial, "Liberation Sans", "DejaVu Sans", sans-serif }
  h1 { font-size: 18pt } .about { font-size: 10.5pt } .verdict { font-size: 13.5pt; line-height: 1.35 } }
"""
#: After all other styles. A table as wide as the sheet wraps its cells, and repeats its head on each sheet.
PRINT_STYLE = """@media print { body { margin: 0; padding: 0; max-width: none }
  nav { display: none } .wide { overflow: visible }
  table { max-width: 100% } th { overflow-wrap: anywhere }
  th, td { white-space: normal; padding: 0.6mm 1mm } thead { display: table-header-group } }
"""
REPORT_STYLE = """h2 { font-size: 12.5pt; margin: 0 0 1mm }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(88mm, 100%), 1fr)); gap: 5mm }
section { break-inside: avoid; margin: 0 0 4mm }
.figures section { max-width: 150mm }
section svg { width: 100%; height: auto; display: block }
@media screen and (prefers-color-scheme: dark) {
  section svg { filter: invert(1) hue-rotate(180deg) } section svg text[style] { fill: var(--dark) }
}
section p { color: var(--soft); margin: 1mm 0; font-size: 9.5pt }
th:first-child, td:first-child, .last td:last-child, .last th:last-child { text-align: left }
.worded td:last-child, .worded th:last-child { text-align: left; min-width: 40mm } .worded th { white-space: normal }
td:last-child { white-space: normal }
@media screen and (max-width: 600px) { td:first-child { white-space: normal; min-width: 32mm } }
details { margin: 0 0 3mm } summary { font-size: 12.5pt; font-weight: bold; cursor: pointer }
details p { color: var(--soft); font-size: 9.5pt }
.last table { break-inside: auto; font-size: 9pt } .last th { white-space: normal } tr { break-inside: avoid }
.last th, .last td { padding: 0.8mm 1.6mm }
@media print { section p { font-size: 8.5pt } .figures { grid-template-columns: 1fr 1fr }
  details::details-content { content-visibility: visible; block-size: auto }
  .last table { font-size: 7.5pt } }
"""


@dataclass(frozen=True)
class ReportFigure:
    """A figure of a report."""

    heading: str  #: the question that it answers.
    caption: str  #: how to read it, and what it includes.
    svg: bytes  #: the figure.


@dataclass(frozen=True)
class HtmlTable:
    """Rows of text below a head, whose first column names them, with an optional note.

    `worded` states that the last column has words rather than numbers.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    worded: bool = False

    def html(self) -> str:
        """Return the element."""
        head = "".join(f"<th>{escape(cell)}</th>" if cell else "<td></td>" for cell in self.head)
        rows = "".join(f"<tr>{''.join(f'<td>{escape(c)}</td>' for c in row)}</tr>" for row in self.rows)
        note = f"<p>{escape(self.note)}</p>" if self.note else ""
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
        kind = "wide worded" if self.worded else "wide"
        return f'<div class="{kind}" tabindex="0">{table}</div>{note}'


def html_document(
    title: str, about: Sequence[str], body: str, style: str = "", head: str = "", lead: str = ""
) -> bytes:
    """Return a page.

    Args:
        title: of the page, as plain text.
        about: lines of HTML below the title.
        body: HTML below these lines.
        style: additions to the common style sheet.
        head: additions to the head element.
        lead: HTML between the title and the lines below it.
    """
    return (
        f'{DOCTYPE}\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}{style}{PRINT_STYLE}</style>{head}</head>\n'
        f'<body><nav></nav><main><h1>{escape(title)}</h1>\n{lead}<p class="about">{"<br>".join(about)}</p>\n'
        f"{body}</main></body></html>\n"
    ).encode()


def check_page_target(path: Path) -> None:
    """Refuse to replace a file that is not an HTML page, such as a design given as output by mistake.

    Raises:
        InputError: the path exists and is not an HTML page.
    """
    if not path.exists():
        return
    try:
        page = path.is_file() and path.read_bytes().startswith(DOCTYPE.encode())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if not page:
        raise InputError(f"{path}: exists and is not an HTML page; name another file with --out")


def report_page(
    title: str,
    about: Sequence[str],
    table: HtmlTable | None,
    sections: Sequence[ReportFigure],
    after: Sequence[tuple[str, HtmlTable]] = (),
    folded: Sequence[tuple[str, Sequence[ReportFigure]]] = (),
    *,
    verdict: str = "",
    opened: Sequence[tuple[str, HtmlTable]] = (),
    first: str = "",
    style: str = "",
) -> bytes:
    """Return the page of a report.

    Args:
        title: of the page.
        about: lines below the title: the assumptions of the figures.
        table: the most important figures, above the charts; None if the charts come first.
        sections: figures, in order.
        after: headings and tables at the end, closed until they are clicked; open in print.
        folded: headings and figures that repeat one kind, also closed until they are clicked.
        verdict: the result in one sentence.
        opened: headings and tables after the figures, always open.
        first: HTML above the figures, for which `style` is added to the style sheet.
    """
    repeated = "".join(
        f'<details><summary>{escape(name)}</summary>\n<div class="figures">\n{_figures(figures)}</div></details>\n'
        for name, figures in folded
        if figures
    )
    last = "".join(
        f"<details class=last><summary>{escape(name)}</summary>{rows.html()}</details>\n" for name, rows in after
    )
    listed = "".join(f"<section><h2>{escape(name)}</h2>{rows.html()}</section>\n" for name, rows in opened)
    head = f"<section>{table.html()}</section>\n" if table else ""
    lead = f'<p class="verdict">{escape(verdict)}</p>\n' if verdict else ""
    figures = f'<div class="figures">\n{_figures(sections)}</div>\n' if sections else ""
    body = f"{first}{head}{figures}{listed}{repeated}{last}"
    return html_document(title, [escape(line) for line in about], body, REPORT_STYLE + style, lead=lead)


def _figures(sections: Sequence[ReportFigure]) -> str:
    return "".join(
        f"<section><h2>{escape(s.heading)}</h2>{labelled(s.svg, s.heading)}<p>{escape(s.caption)}</p></section>\n"
        for s in sections
    )


def labelled(svg: bytes, label: str) -> str:
    """Return an SVG element with a text alternative."""
    return svg.decode().replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1)
