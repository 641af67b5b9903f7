"""The index page of the demo: what was made, with the command that makes each part; filled in while it is made."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from probedesign.reports.html_page import REPORT_STYLE, html_document, labelled

_STYLE = """code { border: 0.4pt solid var(--rule); padding: 0.3mm 1.5mm; border-radius: 1mm; font-size: 9pt }
.links a { margin-right: 4mm } .waiting { color: var(--soft); font-style: italic }
section img { max-width: 100%; background: #fff }
"""
_REFRESH = '<meta http-equiv="refresh" content="2">'


@dataclass
class DemoSection:
    """One step of the demo."""

    heading: str  #: of the step.
    command: str  #: the command that makes it.
    text: str = ""  #: what was made, or why it was not; empty while it is being made.
    svg: bytes = b""  #: a picture in the page.
    html: str = ""  #: html, style: an element of the page instead of a picture, and its style sheet.
    style: str = ""
    picture: str = ""  #: file of a picture beside the page.
    links: Sequence[tuple[str, str]] = field(default_factory=tuple)  #: files beside the page, with what they are.

    def element(self) -> str:
        """Return the section as HTML; a picture links to the first file."""
        if not self.text:
            body = '<p class="waiting">being made ...</p>'
        else:
            shown = self.html or labelled(self.svg, self.heading)
            if self.picture:
                shown = f'<img src="{escape(self.picture)}" alt="{escape(self.heading)}">'
            links = "".join(f'<a href="{escape(file)}">{escape(what)}</a>' for file, what in self.links)
            body = f'{shown}<p>{escape(self.text)}</p><p class="links">{links}</p>'
        return f"<section><h2>{escape(self.heading)}</h2>{body}<p><code>{escape(self.command)}</code></p></section>\n"


def write_demo_page(folder: Path, sections: Sequence[DemoSection]) -> Path:
    """Write index.html; it reloads itself while a section is being made.

    Returns:
        The file.
    """
    about = ["A 150 mm cone of Elastic 50A on an ATI Nano17: from a few dimensions to located touches."]
    body = f'<div class="figures">{"".join(section.element() for section in sections)}</div>'
    head = "" if all(section.text for section in sections) else _REFRESH
    style = "".join([REPORT_STYLE, _STYLE, *(section.style for section in sections)])
    page = folder / "index.html"
    folder.mkdir(parents=True, exist_ok=True)
    page.write_bytes(html_document("probedesign demo", about, body, style, head))
    return page
