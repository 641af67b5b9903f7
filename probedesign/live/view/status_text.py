"""Renders the status of a snapshot as HTML for the page and as a table in the terminal.

All text from outside is escaped.
"""

import math
from html import escape
from typing import TYPE_CHECKING

from probedesign.core.units import MM
from probedesign.live.view.snapshot import ContactMarker, Level, Snapshot
from probedesign.live.view.state import Counts, ViewState

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


COLOURS: dict[Level, str] = {"good": "#1b7f4b", "fair": "#a86400", "bad": "#b3261e", "plain": "#46525e"}
TABLE = (
    "width:100%;border-collapse:collapse;font-size:13px;line-height:1.45;font-variant-numeric:tabular-nums"
)
MAX_SHOWN = 8
"""Maximum number of events and touches on the page: the last ones."""


def status_html(snapshot: Snapshot) -> str:
    """Return the result on a coloured background and the other lines in two columns."""
    if not snapshot.status:
        return ""
    first, *rest = snapshot.status
    rows = "".join(
        f'<tr><td style="color:#75808b;padding-right:10px;vertical-align:top">{escape(line.name)}</td>'
        f'<td style="color:{COLOURS[line.level] if line.level != "plain" else "inherit"}">{escape(line.text)}</td></tr>'
        for line in rest
    )
    ground = (
        f"background:{COLOURS[first.level]};color:white;border-radius:6px;padding:7px 10px;margin-bottom:8px"
    )
    return (
        f'<div style="padding:4px 12px"><div style="{ground};font-size:14px;font-weight:600">{escape(first.text)}</div>'
        f'<table style="{TABLE}">{rows}</table></div>'
    )


def events_html(snapshot: Snapshot) -> str:
    """Return the last events, newest first."""
    lines = "".join(
        f'<tr><td style="color:#75808b;padding-right:8px;vertical-align:top;white-space:nowrap">{_time_text(time)}</td>'
        f"<td>{escape(line)}</td></tr>"
        for time, line in reversed(snapshot.events[-MAX_SHOWN:])
    )
    return f'<div style="padding:2px 12px"><table style="{TABLE};font-size:12px">{lines}</table></div>'


def touches_html(touches: tuple[ContactMarker, ...]) -> str:
    """Return the earlier touches, newest first."""
    if not touches:
        return '<div style="padding:2px 12px;font-size:12px;color:#75808b">none yet; added when a touch ends</div>'
    rows = "".join(_touch(marker) for marker in reversed(touches[-MAX_SHOWN:]))
    head = (
        "<tr style='color:#75808b'><td>no.</td><td>s ± std [mm]</td><td>x, y, z [mm]</td><td>frame</td></tr>"
    )
    return f'<div style="padding:2px 12px"><table style="{TABLE};font-size:12px">{head}{rows}</table></div>'


def _touch(marker: ContactMarker) -> str:
    x, y, z = (f"{float(value) / MM:z.1f}" for value in marker.p_surface)
    frame = "world" if marker.in_world else "base"
    s = f"{marker.s / MM:.1f} ± {marker.std_s / MM:.1f}"
    return f"<tr><td>{marker.number}</td><td>{s}</td><td>{x}, {y}, {z}</td><td>{frame}</td></tr>"


def _time_text(time: float) -> str:
    return f"{time:.1f} s" if math.isfinite(time) else ""


REFRESH_RATE = 8
STYLES: dict[Level, str] = {"good": "bold green", "fair": "yellow", "bad": "bold red", "plain": ""}


class TerminalView(ViewState):
    """Sink that shows a live table at the bottom of a terminal until it is closed."""

    def __init__(self, title: str, counts: Counts = dict, console: "Console | None" = None) -> None:
        """Start the table.

        Args:
            title: title of the table.
            counts: returns the counters of the source: lost, dropped.
            console: console to use; standard output if None.
        """
        from rich.live import Live

        super().__init__(counts)
        self._title = title
        self._live = Live(console=console, get_renderable=self._table, refresh_per_second=REFRESH_RATE)
        self._live.start()

    def close(self) -> None:
        """Stop updating; the last table remains and the cursor is restored."""
        self._live.stop()

    def _table(self) -> "Table":
        return table_of(self._title, self.snapshot(shaped=False))


def table_of(title: str, snapshot: Snapshot) -> "Table":
    """Return the status lines in two columns, and the touches so far."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{title}, {snapshot.since:.1f} s", title_justify="left", show_header=False, box=None)
    for line in snapshot.status:
        table.add_row(Text(line.name, style="dim"), Text(line.text, style=STYLES[line.level]))
    for marker in snapshot.touches[-3:]:
        text = f"s {1e3 * marker.s:.1f} ± {1e3 * marker.std_s:.1f} mm"
        table.add_row(Text(f"touch {marker.number}", style="dim"), Text(text))
    return table
